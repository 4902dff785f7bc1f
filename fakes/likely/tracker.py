"""A tracker or total station somewhere near its nominal place, as noisy as it is said to be, and reflectors
near theirs."""

from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from cell.known_cell import KnownTracker
from cell.poses import from_pose6, to_pose6

PLACE_M, PLACE_RAD = 0.02, 0.005  # how well a tripod is put down where a sketch has it: an assumption
POINT_M = 0.003  # how well a person measures where a reflector is screwed on
SERIAL = "99994400001"
STATION = {"one_by_one": True, "measure_s": 2.0}  # how long its most accurate distance takes: an assumption
RATES_HZ = (1.0, 1000.0)  # between which a twin gives readings
LINK_M = 0.045  # radius of the links, which hide what is behind them


def draw_tracker(known: KnownTracker, rng: np.random.Generator) -> dict[str, Any]:
    """``tracker`` and ``reflectors`` of a scenario's world."""
    off = RigidTransform.from_components(
        PLACE_M * rng.standard_normal(3), Rotation.from_rotvec(PLACE_RAD * rng.standard_normal(3))
    )
    reflectors = {}
    for name, reflector in known.reflectors.items():
        point = np.array(reflector.point) + POINT_M * rng.standard_normal(3)
        arm = "observed" if reflector.observed else "arm"
        reflectors[name] = {"on": "base" if reflector.monument else arm, "point": point.tolist()}
        if reflector.normal is not None:
            reflectors[name] |= {"normal": list(reflector.normal), "half_angle_rad": reflector.half_angle_rad}
    place = to_pose6(from_pose6(known.T_base_tracker) * off).tolist()
    return {
        "tracker": {
            **(STATION if known.one_by_one else {}),
            **({} if known.rate_hz is None else {"rate_hz": float(np.clip(known.rate_hz, *RATES_HZ))}),
            "serial": SERIAL,
            "T_base_tracker": place,
            "sigma0_m": known.sigma0_m,
            "sigma_per_m": known.sigma_per_m,
            "arm_radius_m": LINK_M,
        },
        "reflectors": reflectors,
    }
