"""A cone capture on a twin: a camera near its nominal place, and a board that an operator places anew."""

from cell.known_cell import KnownCamera
from procedures.hand_eye.config import ConeCaptureConfig
from procedures.rehearsal import Rehearsal, joints, needed, nominal, pictures, target
from procedures.setup import Setup


def rehearse_cone(setup: Setup, job: ConeCaptureConfig) -> Rehearsal:
    """``CONFIG_INVALID`` says what the configuration lacks."""
    fixed = job.setup == "eye-to-hand"
    role = "fixed_camera" if fixed else "flange_camera"
    needed(setup, "arm", role)
    look, q = joints(setup, job.start_pose)
    board, stated = target(setup, job.target)
    camera = KnownCamera(
        fixed=fixed,
        T_mount_camera=nominal(setup, "T_base_camera_nominal" if fixed else "T_flange_camera_nominal"),
        target=board,
        looks=[q] * job.placements,
        distance_m=job.distance_m,
        pictures=pictures(setup, role),
        T_flange_target=nominal(setup, "T_flange_target_nominal") if fixed else None,
        **stated,
    )
    return Rehearsal(look, camera=camera, moves_board=True)
