"""One daemon a state folder."""

from pathlib import Path

import pytest

from cell.errors import CellError
from daemon.app import claimed


def test_a_state_folder_belongs_to_one_daemon_and_is_free_after_it(tmp_path: Path) -> None:
    with claimed(tmp_path):
        with pytest.raises(CellError) as refusal, claimed(tmp_path):
            pass
        assert refusal.value.name == "DAEMON_RUNNING"
        assert str(tmp_path) in str(refusal.value)
    with claimed(tmp_path):
        pass
