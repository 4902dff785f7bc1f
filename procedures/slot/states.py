"""The states of the job, and what becomes of the part. LOOK and FETCH are checkpoints, the arm at rest."""

from collections.abc import Mapping
from enum import StrEnum
from typing import Any


class State(StrEnum):
    """Where the job is."""

    PREPARE = "prepare"
    FETCH = "fetch"
    LOOK = "look"
    MEASURE = "measure"
    ALIGN = "align"
    INSERT = "insert"
    RELEASE = "release"
    PULL = "pull"
    PUT_DOWN = "put-down"
    RETREAT = "retreat"
    SOLVE = "solve"


class PartState(StrEnum):
    """What became of the part."""

    NONE = "none"
    GRIPPED = "gripped"
    INSERTED = "inserted"
    JAMMED = "jammed"
    RELEASED = "released"
    LOST = "lost"


S = State

TRANSITIONS: Mapping[Any, frozenset[Any]] = {
    None: frozenset({S.PREPARE}),
    S.PREPARE: frozenset({S.FETCH, S.LOOK, S.RETREAT}),
    S.FETCH: frozenset({S.LOOK, S.SOLVE}),
    S.LOOK: frozenset({S.MEASURE, S.SOLVE}),
    S.MEASURE: frozenset({S.ALIGN, S.PULL, S.SOLVE}),
    S.ALIGN: frozenset({S.INSERT, S.SOLVE}),
    S.INSERT: frozenset({S.RELEASE, S.RETREAT}),
    S.RELEASE: frozenset({S.RETREAT}),
    S.PULL: frozenset({S.PUT_DOWN, S.RETREAT, S.SOLVE}),
    S.PUT_DOWN: frozenset({S.FETCH, S.SOLVE}),
    S.RETREAT: frozenset({S.FETCH, S.LOOK, S.SOLVE}),
    S.SOLVE: frozenset(),
}
CHECKPOINTS = frozenset({S.FETCH, S.LOOK})
