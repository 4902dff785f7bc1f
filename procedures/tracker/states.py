"""The states that a sampling goes through.

NEXT is between two poses, with the arm at rest: a pause holds there, and every finish goes by it. MOVE is
ours, REQUEST asks the program or the operator of an arm that is only observed.
"""

from collections.abc import Mapping
from enum import StrEnum
from typing import Any


class State(StrEnum):
    """Where the job is."""

    PREPARE = "prepare"
    PLAN = "plan"
    LOCATE = "locate"
    MONUMENTS = "monuments"
    SWAP = "swap"
    NEXT = "next"
    MOVE = "move"
    REQUEST = "request"
    SETTLE = "settle"
    MEASURE = "measure"
    REACQUIRE = "reacquire"
    SOLVE = "solve"


S = State

TRANSITIONS: Mapping[Any, frozenset[Any]] = {
    None: frozenset({S.PREPARE}),
    S.PREPARE: frozenset({S.PLAN, S.MONUMENTS}),
    S.PLAN: frozenset({S.LOCATE, S.SWAP, S.NEXT}),
    S.LOCATE: frozenset({S.NEXT, S.MONUMENTS, S.PLAN}),
    S.MONUMENTS: frozenset({S.PLAN, S.SWAP, S.NEXT, S.REACQUIRE, S.SOLVE}),
    S.SWAP: frozenset({S.NEXT}),
    S.NEXT: frozenset({S.NEXT, S.MOVE, S.REQUEST, S.LOCATE, S.MONUMENTS, S.SWAP, S.SOLVE}),
    S.MOVE: frozenset({S.SETTLE, S.NEXT}),
    S.REQUEST: frozenset({S.SETTLE, S.NEXT}),
    S.SETTLE: frozenset({S.MEASURE}),
    S.MEASURE: frozenset({S.SETTLE, S.REACQUIRE, S.NEXT}),
    S.REACQUIRE: frozenset({S.SETTLE, S.MONUMENTS}),
    S.SOLVE: frozenset(),
}
CHECKPOINTS = frozenset({S.NEXT})
