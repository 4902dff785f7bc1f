"""The states that a scan of both beams goes through; the jobs add theirs before and after."""

from collections.abc import Mapping
from enum import StrEnum
from typing import Any


class ScanState(StrEnum):
    """Where a scan is. One way out is SWEEP, the way back RETURN; the other states say what for."""

    PREPARE = "prepare"
    PLAN = "plan"
    APPROACH = "approach"
    SWEEP = "sweep"
    RETURN = "return"
    DESCEND = "descend"
    BISECT = "bisect"
    MEASURE = "measure"
    LIFT = "lift"
    RETRACT = "retract"
    SOLVE = "solve"


S = ScanState

SCAN: Mapping[Any, frozenset[Any]] = {
    None: frozenset({S.PREPARE}),
    S.PREPARE: frozenset({S.PLAN}),
    S.PLAN: frozenset({S.APPROACH}),
    S.APPROACH: frozenset({S.SWEEP, S.RETRACT}),
    S.SWEEP: frozenset({S.RETURN, S.LIFT}),
    S.RETURN: frozenset({S.SWEEP, S.DESCEND, S.BISECT, S.MEASURE, S.LIFT}),
    S.DESCEND: frozenset({S.SWEEP}),
    S.BISECT: frozenset({S.SWEEP}),
    S.MEASURE: frozenset({S.SWEEP}),
    S.LIFT: frozenset({S.SWEEP, S.APPROACH, S.RETRACT}),
    S.RETRACT: frozenset({S.SOLVE}),
    S.SOLVE: frozenset(),
}

# At each the arm rests beside the beams: a pause holds there, a finish lifts the tool and ends.
CHECKPOINTS = frozenset({S.APPROACH, S.SWEEP})
