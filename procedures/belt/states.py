"""The states of picking from a belt."""

from collections.abc import Mapping
from enum import StrEnum
from typing import Any


class PickState(StrEnum):
    """Where the job is."""

    PREPARE = "prepare"
    TO_WAIT = "to-wait"  # on the way to the waiting pose, by joints
    READY = "ready"  # at rest above the belt
    WAIT = "wait"  # above where the next item will be
    APPROACH = "approach"
    DESCEND = "descend"
    GRIP = "grip"
    LIFT = "lift"
    PLACE = "place"
    WAIT_PLACE = "wait-place"  # at rest with an item: the place is not clear
    RETURN = "return"
    STANDING = "standing"  # the belt stands or runs backward
    REPORT = "report"


S = PickState
MOVING: frozenset[Any] = frozenset({S.WAIT, S.APPROACH, S.DESCEND, S.GRIP, S.LIFT, S.PLACE, S.RETURN})
AFTER: Mapping[Any, frozenset[Any]] = {
    S.WAIT: frozenset({S.APPROACH, S.RETURN}),
    S.APPROACH: frozenset({S.DESCEND, S.WAIT, S.RETURN, S.APPROACH}),
    S.DESCEND: frozenset({S.GRIP, S.RETURN, S.WAIT, S.APPROACH}),
    S.GRIP: frozenset({S.LIFT}),
    S.LIFT: frozenset({S.PLACE, S.RETURN, S.WAIT, S.APPROACH}),
    S.PLACE: frozenset({S.RETURN, S.WAIT, S.APPROACH, S.WAIT_PLACE}),
    S.RETURN: frozenset({S.WAIT, S.APPROACH}),
}
PICKING: Mapping[Any, frozenset[Any]] = {
    None: frozenset({S.PREPARE}),
    S.PREPARE: frozenset({S.TO_WAIT}),
    S.TO_WAIT: frozenset({S.READY, S.WAIT_PLACE}),
    S.WAIT_PLACE: frozenset({S.PLACE, S.WAIT_PLACE, S.TO_WAIT, S.REPORT}),
    S.READY: frozenset({S.WAIT, S.APPROACH, S.STANDING, S.REPORT, S.READY}),
    S.STANDING: frozenset({S.STANDING, S.TO_WAIT, S.REPORT}),
    **{state: after | {S.READY, S.STANDING, S.REPORT} for state, after in AFTER.items()},
    S.REPORT: frozenset(),
}
CHECKPOINTS: frozenset[Any] = frozenset({S.READY, S.STANDING, S.WAIT_PLACE})
