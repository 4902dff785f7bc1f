"""The states of the test. NEXT is between two arrivals, the arm at rest: pause and finish hold there."""

from collections.abc import Mapping
from enum import StrEnum
from typing import Any


class State(StrEnum):
    """Where the job is."""

    PREPARE = "prepare"
    PLAN = "plan"
    NEXT = "next"
    MOVE = "move"
    SETTLE = "settle"
    MEASURE = "measure"
    REACQUIRE = "reacquire"
    SOLVE = "solve"


S = State

TRANSITIONS: Mapping[Any, frozenset[Any]] = {
    None: frozenset({S.PREPARE}),
    S.PREPARE: frozenset({S.PLAN}),
    S.PLAN: frozenset({S.NEXT, S.SOLVE}),
    S.NEXT: frozenset({S.MOVE, S.SOLVE}),
    S.MOVE: frozenset({S.SETTLE}),
    S.SETTLE: frozenset({S.MEASURE}),
    S.MEASURE: frozenset({S.SETTLE, S.REACQUIRE, S.NEXT, S.SOLVE}),
    S.REACQUIRE: frozenset({S.SETTLE}),
    S.SOLVE: frozenset(),
}
CHECKPOINTS = frozenset({S.NEXT})
