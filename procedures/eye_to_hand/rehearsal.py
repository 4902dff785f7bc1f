"""A check of a fixed camera on a twin: the camera counts as calibrated, and its target is on the flange."""

import numpy as np

from calibration.kinematics import robot_from_spec
from cell.known_cell import KnownCamera
from cell.poses import from_pose6, to_pose6
from procedures.eye_to_hand.config import EyeToHandCheckConfig
from procedures.rehearsal import Rehearsal, cannot, joints, needed, nominal, pictures, target
from procedures.setup import Setup

_SIGHT_RAD = 0.6  # from the camera's axis: about half of what its picture shows


def rehearse_check(setup: Setup, job: EyeToHandCheckConfig) -> Rehearsal:
    """``CONFIG_INVALID`` says what the configuration lacks."""
    needed(setup, "arm", "fixed_camera")
    look, q = joints(setup, job.start_pose)
    board, stated = target(setup, job.target)
    camera = nominal(setup, "T_base_camera_nominal")
    T_flange_target = from_pose6(job.T_marker_flange).inv()
    flange = robot_from_spec(setup.values.robot).forward(np.array(q))
    seen = from_pose6(camera).inv() * flange * T_flange_target
    aside = float(np.linalg.norm(seen.translation[:2]))
    if np.arctan2(aside, seen.translation[2]) > _SIGHT_RAD:
        x, y, z = (f"{v:.2f}" for v in seen.translation)
        raise cannot(
            f"with the arm at '{look}' the target is out of the camera's sight, at {x}, {y}, {z} m in the "
            "camera by [robot] T_base_camera_nominal and T_marker_flange of the job: give start_pose a pose "
            "of [poses] where the camera sees it, or correct these two"
        )
    known = KnownCamera(
        fixed=True,
        T_mount_camera=camera,
        target=board,
        looks=[q],
        distance_m=float(np.linalg.norm(seen.translation)),
        T_flange_target=to_pose6(T_flange_target).tolist(),
        target_sigma_t_m=job.place_sigma_t_m,
        target_sigma_r_rad=job.place_sigma_r_rad,
        pictures=pictures(setup, "fixed_camera"),
        **stated,
    )
    return Rehearsal(look, camera=known, calibrated_camera=True)
