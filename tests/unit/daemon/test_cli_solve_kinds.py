"""``cellward solve`` calls the solver of every registered kind."""

from pathlib import Path

import pytest

from cell.errors import InputError
from daemon.cli.offline import KINDS, solve_data


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_is_solved_with_all_that_it_may_be_asked(kind: str, tmp_path: Path) -> None:
    missing = tmp_path / "missing.json"
    with pytest.raises(InputError, match=r"missing\.json does not exist"):
        solve_data(kind, missing, None, **dict.fromkeys(KINDS[kind].asked, missing))


@pytest.mark.parametrize("kind", ["cross-check", "touch-test"])
def test_a_method_of_a_kind_that_has_one_only_is_refused(kind: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=f"method is 'other'; {kind} has one only, leave it out"):
        solve_data(kind, tmp_path / "missing.json", "other")
