"""The index of reports of one cell or several, from their state folders."""

from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from cell.store.ledger import Ledger
from cell.store.run_list import listed_runs
from procedures.report.index import IndexedCell, write_index

MOST_RUNS = 500  # in one index


@dataclass(frozen=True)
class CellState:
    """A cell by its name, and its state folder."""

    name: str
    folder: Path


def write_report_index(cells: Sequence[CellState], path: Path, newest: int = MOST_RUNS) -> Path:
    """Write the index of the newest runs of ``cells`` to ``path``; a state folder may be missing yet."""
    return write_index([_indexed(cell, newest) for cell in cells], path)


def _indexed(cell: CellState, newest: int) -> IndexedCell:
    runs, file = cell.folder / "runs", cell.folder / "ledger.sqlite"
    if not file.exists():
        return IndexedCell(cell.name, runs, listed_runs(runs, None, newest))
    with closing(Ledger(file, read_only=True)) as ledger:
        return IndexedCell(cell.name, runs, listed_runs(runs, ledger, newest))
