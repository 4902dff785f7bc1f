"""The states of the job. NEXT is between two targets, the arm at rest: pause and finish hold there."""

from collections.abc import Mapping
from enum import StrEnum
from typing import Any


class State(StrEnum):
    """Where the job is."""

    PREPARE = "prepare"
    NEXT = "next"
    REQUEST = "request"
    SETTLE = "settle"
    MEASURE = "measure"
    REACQUIRE = "reacquire"
    SOLVE = "solve"


S = State

TRANSITIONS: Mapping[Any, frozenset[Any]] = {
    None: frozenset({S.PREPARE}),
    S.PREPARE: frozenset({S.NEXT}),
    S.NEXT: frozenset({S.REQUEST, S.SOLVE}),
    S.REQUEST: frozenset({S.SETTLE, S.NEXT, S.SOLVE}),
    S.SETTLE: frozenset({S.MEASURE}),
    S.MEASURE: frozenset({S.SETTLE, S.REACQUIRE, S.NEXT}),
    S.REACQUIRE: frozenset({S.SETTLE}),
    S.SOLVE: frozenset(),
}
CHECKPOINTS = frozenset({S.NEXT})
