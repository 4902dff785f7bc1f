"""Where the tracker stands: the place that fits the nominal arm's reflectors to their readings."""

from collections.abc import Sequence

import numpy as np

from calibration.identification.registration import Registration, robust_register
from cell.errors import error
from cell.poses import Array, from_pose6, to_pose6

_FLAT = 0.02  # m: points closer than this to one line leave a turn open


def registration_of(T_base_tracker: Sequence[float]) -> Registration:
    """From a pose6 of the tracker in the base."""
    T = from_pose6(T_base_tracker).inv()
    return Registration(T.rotation.as_matrix(), T.translation)


def pose6_of(place: Registration) -> list[float]:
    """``T_base_tracker`` as six numbers."""
    return [float(v) for v in to_pose6(place.pose().inv())]


def locate(p_tracker: Array, p_base: Array, limit_m: float) -> Registration:
    """The place from points (n, 3) of both; ``TRACKER_NOT_LOCATED`` when they do not fit or lie on a line."""
    if len(p_base) < 3 or np.linalg.svd(p_base - p_base.mean(axis=0), compute_uv=False)[1] < _FLAT:
        raise error("TRACKER_NOT_LOCATED", f"the {len(p_base)} points measured lie on a line")
    place = robust_register(p_tracker.T, p_base.T, np.ones(len(p_base)))
    off = np.linalg.norm(place.to_tracker(p_base.T).T - p_tracker, axis=1)
    rms = float(np.sqrt(np.mean(off**2)))
    if rms > limit_m:
        raise error(
            "TRACKER_NOT_LOCATED",
            f"in its best place the nominal arm is {1e3 * rms:.1f} mm off, max_locate_error_m is "
            f"{1e3 * limit_m:g} mm",
        )
    return place


def apart(a: Sequence[float], b: Sequence[float]) -> tuple[float, float]:
    """How far two poses (pose6) are from each other, m and rad."""
    T = from_pose6(a).inv() * from_pose6(b)
    return float(np.linalg.norm(T.translation)), float(T.rotation.magnitude())
