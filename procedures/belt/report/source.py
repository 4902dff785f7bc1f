"""What the sections of a report on picking ask for: item lives from the journal, rows from framed files."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cell.errors import CellError
from cell.poses import Array
from procedures.belt.record import (
    BELIEF,
    BELIEF_FILE,
    COUNT,
    COUNTS_FILE,
    STEP,
    STEPS_FILE,
    read_rows,
)
from procedures.belt.result import BeltTrackingResult
from procedures.report.numbers import number
from procedures.report.source import Source

_LARGEST = 64 * 2**20  # bytes of a framed file that a report still reads


@dataclass(frozen=True)
class ItemLife:
    """One item that ended: when each thing happened to it, s since the run began."""

    number: int
    outcome: str
    end: float
    sightings: int
    history: tuple[tuple[float, str], ...]
    contact_95_m: float | None = None

    def at(self, what: str) -> float | None:
        """When ``what`` first happened."""
        return next((t for t, name in self.history if name == what), None)

    def took(self, since: str, until: str) -> float | None:
        """Seconds from one thing to the other; None when either did not happen."""
        a, b = self.at(since), self.at(until)
        return None if a is None or b is None else b - a


@dataclass
class BeltSource(Source[BeltTrackingResult]):
    """A result of kind ``belt-tracking``."""

    @cached_property
    def begin(self) -> float:
        """The cell's clock at the first line of the journal."""
        times = [t for line in self.journal if (t := number(line.get("t"))) is not None]
        return min(times, default=0.0)

    @cached_property
    def lives(self) -> list[ItemLife]:
        """Items that ended, in the order of their ends."""
        return [life for line in self.journal if (life := self._life(line)) is not None]

    def _life(self, line: Mapping[str, Any]) -> ItemLife | None:
        history, end = line.get("history"), number(line.get("t"))
        if line.get("event") != "item" or not isinstance(history, list) or end is None:
            return None
        rows = tuple((float(t) - self.begin, str(what)) for t, what in history)
        return ItemLife(
            int(line["item"]),
            str(line.get("outcome")),
            end - self.begin,
            int(line.get("sightings") or 0),
            rows,
            number(line.get("contact_95_m")),
        )

    @cached_property
    def counts(self) -> NDArray[Any] | str:
        """Rows of ``COUNT``, or why there are none."""
        return self._rows(COUNTS_FILE, COUNT)

    @cached_property
    def steps(self) -> NDArray[Any] | str:
        """Rows of ``STEP``, or why there are none."""
        return self._rows(STEPS_FILE, STEP)

    @cached_property
    def belief(self) -> NDArray[Any] | str:
        """Rows of ``BELIEF``, or why there are none."""
        return self._rows(BELIEF_FILE, BELIEF)

    def _rows(self, name: str, kind: np.dtype[Any]) -> NDArray[Any] | str:
        path = None if self.folder is None else Path(self.folder) / name
        if path is None or not path.exists():
            return f"{name} did not come with this result."
        if path.stat().st_size > _LARGEST:
            return f"{name} is too long to be drawn; intercept.json has its end."
        try:
            rows = read_rows(path, kind)
        except CellError as exc:
            return str(exc)
        return rows if len(rows) > 1 else f"{name} has no rows."

    @property
    def scale(self) -> float | None:
        """Metres per count."""
        return number(self._belt.get("m_per_count"))

    @property
    def way(self) -> Array:
        """(3,) unit vector of the belt in the base."""
        return np.array(self._belt.get("dir") or [1.0, 0.0, 0.0], dtype=float)

    @property
    def _belt(self) -> Mapping[str, Any]:
        return (None if self.found is None else self.found.inputs.belt) or {}
