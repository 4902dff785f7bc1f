"""The states of a cone capture, and which follows which."""

from enum import StrEnum
from typing import Any


class State(StrEnum):
    """Where the job is."""

    PREPARE = "prepare"
    PLACE = "place"
    START_POSE = "start-pose"
    SEEK = "seek"
    SEARCH = "search"
    PLAN = "plan"
    MOVE = "move"
    SETTLE = "settle"
    CAPTURE = "capture"
    RETURN = "return"
    REFINE = "refine"
    SOLVE = "solve"


S = State
TRANSITIONS: dict[Any, frozenset[Any]] = {
    None: frozenset({S.PREPARE}),
    S.PREPARE: frozenset({S.PLACE, S.SOLVE}),
    S.PLACE: frozenset({S.PLACE, S.START_POSE, S.SOLVE}),
    S.START_POSE: frozenset({S.SEEK}),
    S.SEEK: frozenset({S.SEARCH, S.PLAN, S.PLACE, S.SOLVE}),
    S.SEARCH: frozenset({S.MOVE, S.PLAN, S.PLACE}),
    S.PLAN: frozenset({S.MOVE, S.RETURN, S.PLACE}),
    S.MOVE: frozenset({S.SETTLE, S.MOVE, S.RETURN, S.SOLVE}),
    S.SETTLE: frozenset({S.CAPTURE}),
    S.CAPTURE: frozenset({S.SETTLE, S.MOVE, S.RETURN, S.SEARCH}),
    S.RETURN: frozenset({S.REFINE, S.PLACE}),
    S.REFINE: frozenset({S.PLACE, S.SOLVE}),
    S.SOLVE: frozenset(),
}
