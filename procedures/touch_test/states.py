"""The states of the job. APPROACH is between two corners, the arm at rest: pause and finish hold there.

A pause holds before the arm is lifted, too; a finish lifts it, unless a person has it in local mode.
"""

from collections.abc import Mapping
from enum import StrEnum
from typing import Any


class State(StrEnum):
    """Where the job is."""

    PREPARE = "prepare"
    LOOK = "look"
    PLAN = "plan"
    APPROACH = "approach"
    TOUCH = "touch"
    LIFT = "lift"
    SOLVE = "solve"


S = State

TRANSITIONS: Mapping[Any, frozenset[Any]] = {
    None: frozenset({S.PREPARE}),
    S.PREPARE: frozenset({S.LOOK}),
    S.LOOK: frozenset({S.PLAN}),
    S.PLAN: frozenset({S.APPROACH}),
    S.APPROACH: frozenset({S.TOUCH, S.SOLVE}),
    S.TOUCH: frozenset({S.TOUCH, S.LIFT}),
    S.LIFT: frozenset({S.APPROACH, S.SOLVE}),
    S.SOLVE: frozenset(),
}
CHECKPOINTS = frozenset({S.APPROACH})
