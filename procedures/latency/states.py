"""Where a latency calibration is, and where it may go from there."""

from enum import StrEnum
from typing import Any


class State(StrEnum):
    """Where the job is."""

    PREPARE = "prepare"
    APPROACH = "approach"
    SWEEP = "sweep"
    RETURN = "return"
    LIFT = "lift"
    WATCH = "watch"  # the belt starts and stops
    SOLVE = "solve"


S = State
TRANSITIONS: dict[Any, frozenset[Any]] = {
    None: frozenset({S.PREPARE}),
    S.PREPARE: frozenset({S.APPROACH, S.WATCH}),
    S.APPROACH: frozenset({S.SWEEP, S.SOLVE}),
    S.SWEEP: frozenset({S.RETURN, S.LIFT}),
    S.RETURN: frozenset({S.SWEEP, S.LIFT}),
    S.LIFT: frozenset({S.SOLVE}),
    S.WATCH: frozenset({S.WATCH, S.SOLVE}),
    S.SOLVE: frozenset(),
}
