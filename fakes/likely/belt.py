"""A belt that runs not quite as drawn, boxes on it, and the gripper."""

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from cell.known_cell import KnownBelt, KnownGripper
from cell.usual_belt import SCALE_SHARE, TURN_RAD
from cell.usual_delays import ENCODER_JITTER_S, ENCODER_LATE_S

UPSTREAM_M = 1.0  # the first item, before the point that the arm waits above
SPACING_M = 0.4
# A person at a belt's switch, and the ramps of its drive: assumptions, those of the demo's delays.
STOPS = {"every_s": [1.0, 3.0], "held_s": [0.3, 1.0], "accel_m_s2": [0.3, 1.2]}
MOVES_S = (0.2, 0.6)  # of grippers with two fingers
# Of the time after which one counts as closed, as its section says, where nothing confirms it: an assumption.
WITHIN = (0.7, 1.0)
# An encoder's range in a twin: no belt comes to the end of a larger one, and none has fewer.
COUNTS = (16, 0xFFFF_FFFF)
SERIAL = "999966001"


def draw_belt(known: KnownBelt, rng: np.random.Generator) -> dict[str, Any]:
    """``belt`` and ``items`` of a scenario's world."""
    direction = Rotation.from_rotvec([0.0, 0.0, TURN_RAD * rng.standard_normal()]).apply(known.dir)
    origin = [float(known.above[0]), float(known.above[1]), known.z_m]
    low, high = known.item_heights_m
    return {
        "belt": {
            "serial": SERIAL,
            "jitter_s": ENCODER_JITTER_S,
            "late_s": float(rng.spawn(1)[0].uniform(*ENCODER_LATE_S)),
            "m_per_count": known.m_per_count * float(1.0 + SCALE_SHARE * rng.standard_normal()),
            "origin": origin,
            "dir": direction.tolist(),
            "period_s": known.period_s,
            **(
                {}
                if known.range_counts is None
                else {"modulus": min(max(known.range_counts, COUNTS[0]), COUNTS[1])}
            ),
            "profile": [{"speed_m_s": known.speed_m_s}],
            **({"stops": STOPS} if known.stops else {}),
        },
        "items": {
            "height_m": [low + 0.25 * (high - low), high - 0.25 * (high - low)],
            "spacing_m": SPACING_M,
            "jitter_m": 0.05,
            "lateral_m": 0.03,
            "yaw_rad": 0.4,
            "first_m": UPSTREAM_M,
        },
    }


def draw_gripper(known: KnownGripper, rng: np.random.Generator) -> dict[str, Any]:
    """``gripper`` of a scenario's world."""
    confirm = {} if known.confirm is None else {"confirm": known.confirm}
    low, high = MOVES_S if known.moves_s is None else known.moves_s * np.array(WITHIN)
    moves_s = {name: float(rng.uniform(low, high)) for name in ("close_s", "open_s")}
    return {"output": known.output, **confirm, **moves_s}
