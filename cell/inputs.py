"""From polls of digital inputs to edges, each with the interval that encloses it."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from cell.devices import InputsState
from cell.samples import Sample


@dataclass(frozen=True, slots=True)
class Edge:
    """One change of an input's level: it happened within ``t - dt .. t + dt`` (CLOCK_MONOTONIC seconds)."""

    rising: bool
    t: float
    dt: float


def edges(polls: Sequence[Sample[InputsState]], index: int) -> list[Edge]:
    """The changes of input ``index`` between the polls of one epoch, oldest first.

    An edge lies between the start of the poll before it and the end of the poll that shows it. The edges of a
    pulse that came and went between two polls share one bracket.
    """
    found: list[Edge] = []
    for before, after in pairwise(polls):
        low, high = before.t - before.dt, after.t + after.dt
        rising = not before.value.levels[index]
        for _ in range(after.value.changes[index] - before.value.changes[index]):
            found.append(Edge(rising, 0.5 * (low + high), 0.5 * (high - low)))
            rising = not rising
    return found
