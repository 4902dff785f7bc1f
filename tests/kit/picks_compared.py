"""Two runs of picking beside each other: what became of the items, and where the tool was wanted."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cell.poses import Array
from cell.store.journal import read_journal
from cell.store.runs import JOURNAL_FILE, list_runs
from procedures.belt.items import CONTACT
from tests.kit.stream_instants import SAME_S, steps_of


@dataclass(frozen=True)
class PicksCompared:
    """``ends``: item and what became of it in order, of either run. Distances in m are of the tool's point as
    it was wanted, at the ``common`` instants that both runs decided about: the largest anywhere, and the
    largest where the tool touched an item; ``contact_s`` is by how much those instants differ."""

    ends: tuple[list[tuple[int, str]], list[tuple[int, str]]]
    steps: tuple[int, int]
    common: int
    anywhere_m: float
    contacts: tuple[int, int]
    contact_s: float
    contact_m: float

    def __str__(self) -> str:
        same = "the same items in the same order" if self.ends[0] == self.ends[1] else "OTHER ITEMS"
        return (
            f"{same}: {len(self.ends[0])}; set-points for the same instant: {self.common} of {self.steps[0]},"
            f" apart by at most {1e3 * self.anywhere_m:.4f} mm; {self.contacts[0]} contacts apart by at most"
            f" {1e3 * self.contact_m:.4f} mm and {1e3 * self.contact_s:.1f} ms"
        )


def compare_picks(one: Path, other: Path) -> PicksCompared:
    """Of the runs below two state folders."""
    a, b = steps_of(one), steps_of(other)
    at = np.clip(np.searchsorted(b[:, 0], a[:, 0] - SAME_S), 0, max(len(b) - 1, 0))
    common = np.abs(b[at, 0] - a[:, 0]) < SAME_S
    apart = np.linalg.norm((b[at, 1:] - a[:, 1:])[common], axis=1)
    touched, again = _contacts(one), _contacts(other)
    pairs = list(zip(touched, again, strict=False))
    return PicksCompared(
        ends=(_ends(one), _ends(other)),
        steps=(len(a), len(b)),
        common=int(common.sum()),
        anywhere_m=float(apart.max(initial=0.0)),
        contacts=(len(touched), len(again)),
        contact_s=max((abs(s - t) for s, t in pairs), default=0.0),
        contact_m=max((float(np.linalg.norm(_tool(a, s) - _tool(b, t))) for s, t in pairs), default=0.0),
    )


def _items(state: Path) -> list[dict[str, Any]]:
    lines = [line for run in list_runs(state / "runs") for line in read_journal(run.path / JOURNAL_FILE)]
    return [line for line in lines if line.get("event") == "item"]


def _ends(state: Path) -> list[tuple[int, str]]:
    return [(line["item"], line["outcome"]) for line in _items(state)]


def _contacts(state: Path) -> list[float]:
    return [t for line in _items(state) for t, what in line["history"] if what == CONTACT]


def _tool(steps: Array, t: float) -> Array:
    found: Array = steps[np.argmin(np.abs(steps[:, 0] - t)), 1:]
    return found
