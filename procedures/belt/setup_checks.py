"""What looks mistaken in how a belt is set up, though it could be picked from: units, senses, heights."""

from collections.abc import Iterator

import numpy as np

from cell.poses import Array, from_pose6
from procedures.belt.calibrating.config import BeltCalibrationConfig
from procedures.belt.config import BeltTrackingConfig, ItemLook
from procedures.setup import Setup

_COARSE_M = 0.5e-3  # RMS of a count's rounding; the arm meets items that well at best
_LEAST_HEIGHT_M = 0.1  # of a camera above the belt
_OTHER_M = 0.002  # between heights of one belt


def belt_setup(setup: Setup, job: BeltTrackingConfig) -> Iterator[str]:
    """One sentence, with what to do, for each."""
    if (belt := setup.values.belt) is not None:
        if (rounding := abs(belt["m_per_count"]) / np.sqrt(12.0)) > _COARSE_M:
            yield (
                f"belt_nominal.m_per_count = {belt['m_per_count']:g} m: the rounding of a count alone is "
                f"{1e3 * rounding:.1f} mm RMS of every place; it is metres of belt for one count"
            )
        yield from _camera(setup, job, np.array(belt["dir"], dtype=float))
    other = setup.job(BeltCalibrationConfig)
    z = None if other is None else other.belt_z_m
    if z is not None and abs(z - job.belt_z_m) > _OTHER_M:
        yield (
            f"belt_z_m is {job.belt_z_m:g} m here and {z:g} m in [job.belt-calibration]; it is the "
            "height of one belt in the base"
        )


def needs_depth(setup: Setup, job: str, items: ItemLook) -> Iterator[str]:
    """That a camera without depth cannot find the items of ``job``, whose height is not known."""
    if setup.without_depth("fixed_camera") and items.height_m is None:
        yield (
            f"[device.{setup.roles['fixed_camera']}] has depth = false, and items are found by depth: give "
            f"[job.{job}.items] height_m, the known height of all items, or use a camera with depth"
        )


def _camera(setup: Setup, job: BeltTrackingConfig, way: Array) -> Iterator[str]:
    """Where the camera looks by its nominal pose at the belt, beside the zone."""
    nominal = setup.nominal["T_base_camera_nominal"]
    if nominal is None:
        return
    T = from_pose6(nominal)
    sight, height = T.rotation.apply([0.0, 0.0, 1.0]), float(T.translation[2]) - job.belt_z_m
    if height < _LEAST_HEIGHT_M or sight[2] >= 0.0:
        yield (
            f"belt_z_m = {job.belt_z_m:g} m: by its nominal pose (T_base_camera_nominal) the camera at "
            f"{T.translation[2]:g} m does not look down on the belt; look which of them is wrong"
        )
        return
    along = float((T.translation - height / sight[2] * sight) @ way)
    if along > job.zone.max_m:
        yield (
            f"the nominal camera looks at the belt at {along:.2f} m along dir, behind the end of the "
            f"zone at {job.zone.max_m:g} m: items are seen when they have passed the arm; belt_nominal.dir "
            "is the way that the belt runs, and zone is counted along it"
        )
