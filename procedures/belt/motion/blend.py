"""The blend between a level move and the straight one onto an item or a place."""

from dataclasses import dataclass

import numpy as np

from calibration.belt.pursuit import FixedPoint, PursuitLimits, PursuitState, plan
from procedures.belt.config import BeltTrackingConfig

STRAIGHT_M = 0.02
BESIDE_M = 0.003  # of the item's axis that the tool may be at the upper end of the straight way
_STEP_S = 0.001
_LEVEL_M = 0.3  # a way long enough to end as all do


@dataclass(frozen=True)
class Blend:
    """``reach_s`` the way down takes to the upper end of its straight part; ``last_s`` is what a level way
    has left when the tool is within 3 mm of its end. The tool may leave sideways ``clear_m`` above where it
    gripped or let go: what it has sunk into the item comes on top of the straight part.
    """

    reach_s: float
    last_s: float
    clear_m: float

    @property
    def lead_s(self) -> float:
        """So long before its end a level way may turn down."""
        return self.reach_s + self.last_s


def blend_for(config: BeltTrackingConfig, limits: PursuitLimits, least_m: float = 0.0) -> Blend:
    """What ``config`` asks for, straight for ``least_m`` or more, as it is driven within ``limits``.

    A way down that is shorter than that is straight from the level way on.
    """
    down_m, straight = config.down_m, config.straight_m
    if straight is None:
        if config.method == "classic":
            return Blend(0.0, 0.0, down_m)
        straight = min(STRAIGHT_M, config.above_m)
    straight = max(straight, least_m)
    straight += config.sunk_m
    rest = PursuitState.still(np.zeros(4))
    down = plan(0.0, rest, FixedPoint(rest.p), np.array([0.0, 0.0, -down_m, 0.0]), limits)
    level = plan(0.0, rest, FixedPoint(rest.p), np.array([_LEVEL_M, 0.0, 0.0, 0.0]), limits)
    level_m = max(down_m - straight, 0.0)
    high = [t for t in np.arange(0.0, down.t1, _STEP_S) if -down.at(t).p[2] <= level_m]
    off = [t for t in np.arange(0.0, level.t1, _STEP_S) if level.at(t).p[0] <= _LEVEL_M - BESIDE_M]
    return Blend(float(high[-1]), float(level.t1 - off[-1]), straight)
