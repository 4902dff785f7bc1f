"""A pipe where a file of a run should be is refused: whoever read it would wait for ever."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from cell.errors import CellError
from cell.store.files import read_json
from cell.store.framed import read_framed
from cell.store.journal import read_journal
from cell.store.pruning import RECORD_FILE, removals_recorded
from cell.store.signatures import SIGNATURES_FILE, read_signatures


def _journal(folder: Path) -> Any:
    return read_journal(folder / "journal.jsonl")


def _json(folder: Path) -> Any:
    return read_json(folder / "end.json")


def _frames(folder: Path) -> Any:
    return read_framed(folder / "calibrations.log")


READERS: dict[str, Callable[[Path], Any]] = {
    "journal.jsonl": _journal,
    "end.json": _json,
    "calibrations.log": _frames,
    SIGNATURES_FILE: read_signatures,
    RECORD_FILE: removals_recorded,
}


@pytest.mark.parametrize("name", READERS)
def test_a_pipe_is_refused_at_once(tmp_path: Path, name: str) -> None:
    os.mkfifo(tmp_path / name)
    with pytest.raises(CellError) as refused:
        READERS[name](tmp_path)
    assert refused.value.name == "FILE_UNREADABLE"
    assert "neither a file nor a folder" in str(refused.value)
