"""The items on their way: seen, waiting to be picked, and what became of each."""

from collections import Counter, deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment

from calibration.belt.items import NEWEST, Sighting, facing
from cell.poses import Array

CONTACT = "contact"  # in an item's life: the tool is on it


class Outcome(StrEnum):
    """What became of an item; all but the first are misses, by cause."""

    PICKED = "picked"
    NOT_DETECTED = "not detected"
    OUT_OF_ZONE = "out of zone"
    LOST = "lost"
    GRIP_FAILED = "grip failed"
    QUEUE_FULL = "queue full"


@dataclass(eq=False)
class Item:
    """One item. ``along`` and ``across`` (m) are its place on the belt at zero travel, as last seen."""

    number: int
    along: float
    across: float
    yaw: float  # rad, of its longer side in the base; what its newest sightings have in common
    sightings: int = 0
    yaws: deque[float] = field(default_factory=lambda: deque(maxlen=NEWEST))
    outcome: Outcome | None = None
    history: list[tuple[float, str]] = field(default_factory=list)
    turn: float = 0.0  # rad, of the tool that is along its longer side
    refused_until: float = 0.0  # s: out of reach when it was last tried
    contact: Mapping[str, Any] = field(default_factory=dict)  # how far off it may have been, m

    @property
    def key(self) -> str:
        """Its name in the belt tracker."""
        return str(self.number)

    @property
    def touched(self) -> bool:
        """Whether the tool was on it."""
        return any(what == CONTACT for _, what in self.history)

    def note(self, t: float, what: str) -> None:
        """One line of its life, at ``t`` s of the cell's clock."""
        self.history.append((t, what))


class Queue:
    """Items by their place on the belt. Numbers begin at 1 and are never given twice in a run."""

    def __init__(self, spacing_m: float) -> None:
        self._spacing_m = spacing_m
        self.items: list[Item] = []
        self.counts: Counter[Outcome] = Counter()
        self.seen = 0
        self._places: Array = np.zeros((0, 2))  # along and across of ``items``, in their order

    def place(self, places: Array, yaws: Sequence[float]) -> list[Item]:
        """The items that the sightings of one frame belong to, each to its own: known ones, or new ones.

        ``places`` (k, 2) along and across at zero travel (m), ``yaws`` (k,) rad. What was picked or missed
        stays known until it is far past, so it is not found a second time.
        """
        away = np.hypot(*np.moveaxis(self._places - places[:, None], 2, 0))
        near = np.flatnonzero((away <= self._spacing_m).any(axis=0))
        away = away[:, near]
        rows, columns = linear_sum_assignment(np.minimum(away, self._spacing_m))
        known = {k: near[j] for k, j in zip(rows, columns, strict=True) if away[k, j] <= self._spacing_m}
        return [
            self._saw(known.get(k), float(along), float(across), yaw)
            for k, ((along, across), yaw) in enumerate(zip(places, yaws, strict=True))
        ]

    def _saw(self, k: int | None, along: float, across: float, yaw: float) -> Item:
        """A sighting of item ``k`` of :attr:`items`, or of a new one."""
        if k is None:
            k, self.seen = len(self.items), self.seen + 1
            self.items.append(Item(self.seen, along, across, yaw))
            self._places = np.vstack([self._places, [along, across]])
        item = self.items[k]
        item.along, item.across = along, across
        item.yaws.append(yaw)
        item.yaw = facing(item.yaws)
        self._places[k] = along, across
        item.sightings += 1
        return item

    def beyond(self, along: float) -> list[Item]:
        """Items whose place is farther downstream than this (m, zero travel)."""
        return [self.items[k] for k in np.flatnonzero(self._places[:, 0] > along)]

    def shift(self, by_m: float) -> None:
        """All items lie so much farther along than was believed."""
        for item in self.items:
            item.along += by_m
        self._places[:, 0] += by_m

    def keep(self, items: list[Item]) -> None:
        """Forget all but these."""
        self.items = items
        self._places = np.array([(i.along, i.across) for i in items]).reshape(-1, 2)

    def waiting(self, min_sightings: int) -> list[Item]:
        """Items that can still be picked, the farthest downstream first."""
        open_ = [i for i in self.items if i.outcome is None and i.sightings >= min_sightings]
        return sorted(open_, key=lambda item: -item.along)

    def end(self, item: Item, outcome: Outcome, t: float) -> None:
        """What became of ``item``; an item ends once."""
        if item.outcome is not None:
            raise ValueError(f"item {item.number} already ended as {item.outcome}")
        item.outcome = outcome
        item.note(t, outcome.value)
        self.counts[outcome] += 1

    @property
    def length(self) -> int:
        """How many can still be picked."""
        return sum(i.outcome is None for i in self.items)

    def live(self) -> dict[str, int]:
        """Counters by the names of the registers."""
        misses = {o: self.counts[o] for o in Outcome if o is not Outcome.PICKED}
        named = {f"missed_{o.value.replace(' ', '_')}": n for o, n in misses.items()}
        return {
            "picks": self.counts[Outcome.PICKED],
            "misses": sum(misses.values()),
            "queue_length": self.length,
            **named,
        }


def as_sighting(point: Array, t: float, arrived: float, sigma_m: float) -> Sighting:
    """A sighting of the tracker from a grasp point (3,) in the base, exposed at ``t``; ``sigma_m`` as the
    detector states it."""
    return Sighting((float(point[0]), float(point[1])), t, arrived, True, sigma_m)


def life(item: Item) -> dict[str, Any]:
    """An item's life as plain values, for journal and ledger."""
    history = [[round(t, 4), what] for t, what in item.history]
    return {"sightings": item.sightings, "history": history, **item.contact}
