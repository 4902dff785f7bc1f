"""Picking from a belt, and calibrating one, on a twin."""

import numpy as np

from calibration.kinematics import robot_from_spec
from cell.known_cell import KnownBelt, KnownCamera
from cell.poses import from_pose6
from procedures.belt.calibrating.config import BeltCalibrationConfig
from procedures.belt.config import BeltTrackingConfig, ItemLook
from procedures.rehearsal import (
    Rehearsal,
    cannot,
    gripper,
    joints,
    measured_delay,
    needed,
    nominal,
    pictures,
    target,
)
from procedures.setup import Setup

SPEED_M_S = 0.15  # no configuration says how fast a belt runs
PICKS = 10
CALIBRATION = "belt-calibration"


def rehearse_picking(setup: Setup, job: BeltTrackingConfig) -> Rehearsal:
    """``CONFIG_INVALID`` says what the configuration lacks."""
    needed(setup, *job.roles())
    calibrating = setup.job(BeltCalibrationConfig)
    calibrated = calibrating is not None and _by_camera(calibrating)
    known = gripper(setup, job.place_clear)
    look, q = joints(setup, job.wait_pose)
    return Rehearsal(
        look,
        camera=camera_above(setup, q),
        belt=belt_below(setup, q, job.belt_z_m, job.items),
        gripper=known,
        items=job.picks or PICKS,
        before=(CALIBRATION,) if calibrated else (),
        calibrated_camera=True,
    )


def rehearse_calibration(setup: Setup, job: BeltCalibrationConfig) -> Rehearsal:
    """``CONFIG_INVALID`` says what the configuration lacks."""
    needed(setup, "arm", "fixed_camera", "belt")
    if not _by_camera(job) or job.belt_z_m is None:
        raise cannot('source = "touch": the belt is touched by a person, and a twin has none')
    picking = setup.job(BeltTrackingConfig)
    look, q = joints(setup, None if picking is None else picking.wait_pose)
    return Rehearsal(
        look,
        camera=camera_above(setup, q),
        belt=belt_below(setup, q, job.belt_z_m, job.items),
        calibrated_camera=True,
    )


def _by_camera(job: BeltCalibrationConfig) -> bool:
    return job.source == "camera" and job.belt_z_m is not None


def camera_above(setup: Setup, q: list[float]) -> KnownCamera:
    """The camera above the belt; the board that it was calibrated with hangs out of its sight."""
    names = list(setup.values.targets)
    if not names:
        raise cannot("there is no [target.NAME], with which the fixed camera was calibrated; add it")
    board, stated = target(setup, names[0])
    return KnownCamera(
        fixed=True,
        T_mount_camera=nominal(setup, "T_base_camera_nominal"),
        target=board,
        looks=[q],
        distance_m=1.0,
        pictures=pictures(setup, "fixed_camera"),
        T_flange_target=setup.nominal["T_flange_target_nominal"] or [0.0, 0.0, -0.5, 0.0, 0.0, 0.0],
        **stated,
    )


def belt_below(setup: Setup, q: list[float], z_m: float, items: ItemLook, stops: bool = False) -> KnownBelt:
    """The belt under the tool with the arm at joints ``q`` (6,) rad, its surface at ``z_m`` in the base."""
    if setup.values.belt is None:
        raise cannot("[robot] belt_nominal is missing, around which the twin's belt would be drawn; give it")
    tool = from_pose6(setup.values.tool["T_flange_tool"])
    above = (robot_from_spec(setup.values.robot).forward(np.array(q)) * tool).translation
    encoder = setup.devices[setup.roles["belt"]]
    bits = getattr(encoder, "width_bits", None)
    return KnownBelt(
        m_per_count=float(setup.values.belt["m_per_count"]),
        dir=[float(v) for v in setup.values.belt["dir"]],
        z_m=z_m,
        above=[float(v) for v in above],
        speed_m_s=SPEED_M_S,
        item_heights_m=(items.min_height_m, items.max_height_m),
        stops=stops,
        period_s=getattr(encoder, "period_s", KnownBelt.period_s),
        range_counts=getattr(encoder, "range_counts", None) or (1 << bits if bits else None),
        delay=measured_delay(setup, "belt"),
    )
