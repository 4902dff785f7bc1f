"""A latency calibration on a twin: of beams, as every crossing, or of a camera that sees a target."""

from cell.known_cell import KnownCamera
from procedures.laser.rehearsal import rehearse_measurement
from procedures.latency.config import LatencyCalibrationConfig
from procedures.rehearsal import Rehearsal, cannot, joints, needed, nominal, pictures, target
from procedures.setup import Setup

DISTANCE_M = 0.5  # from camera to target, where the configuration does not tell it


def rehearse_delay(setup: Setup, job: LatencyCalibrationConfig) -> Rehearsal:
    """``CONFIG_INVALID`` says what the configuration lacks."""
    if job.source == "beams":
        return rehearse_measurement(setup, job)
    if job.source == "belt":
        raise cannot("nobody starts and stops the belt of a twin that is made for a rehearsal")
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
