"""A latency calibration on a twin: of beams, as every crossing, of a camera that sees a target, or of the
encoder of a belt that somebody starts and stops."""

from cell.known_cell import KnownCamera
from procedures.belt.config import BeltTrackingConfig
from procedures.belt.rehearsal import belt_below, camera_above
from procedures.laser.rehearsal import rehearse_measurement
from procedures.latency.config import LatencyCalibrationConfig
from procedures.rehearsal import Rehearsal, joints, needed, nominal, pictures, target
from procedures.setup import Setup

DISTANCE_M = 0.5  # from camera to target, where the configuration does not tell it


def rehearse_delay(setup: Setup, job: LatencyCalibrationConfig) -> Rehearsal:
    """``CONFIG_INVALID`` says what the configuration lacks."""
    if job.source == "beams":
        return rehearse_measurement(setup, job)
    if job.source == "belt":
        return _of_encoder(setup, job)
    fixed = job.source == "fixed_camera"
    needed(setup, "arm", job.source)
    look, q = joints(setup, job.pose)
    board, stated = target(setup, job.target or "")
    camera = KnownCamera(
        fixed=fixed,
        T_mount_camera=nominal(setup, "T_base_camera_nominal" if fixed else "T_flange_camera_nominal"),
        target=board,
        looks=[q],
        distance_m=DISTANCE_M,
        pictures=pictures(setup, job.source),
        T_flange_target=nominal(setup, "T_flange_target_nominal") if fixed else None,
        **stated,
    )
    return Rehearsal(look, camera=camera)


def _of_encoder(setup: Setup, job: LatencyCalibrationConfig) -> Rehearsal:
    """The camera's own delay counts as measured before, as well as a run of this job leaves it known."""
    needed(setup, "arm", "fixed_camera", "belt")
    picking = setup.job(BeltTrackingConfig)
    look, q = joints(setup, None if picking is None else picking.wait_pose)
    return Rehearsal(
        look,
        camera=camera_above(setup, q),
        belt=belt_below(setup, q, job.belt_z_m or 0.0, job.items, stops=True),
        calibrated_camera=True,
        measured_camera=True,
    )
