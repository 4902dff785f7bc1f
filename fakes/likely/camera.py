"""A camera that is not quite where it was drawn, whose lens has moved, before a board that was printed."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from cell.known_cell import KnownCamera, KnownPictures
from cell.poses import Array, from_pose6, to_pose6
from cell.usual_camera import larger, usual_K
from cell.usual_delays import CAMERA
from fakes.world.arm.kinematics import Chain

DIST = [0.021, -0.043, 0.0006, -0.0004, 0.0]
MOUNT_M, MOUNT_RAD = 0.004, 0.015  # of brackets as they are made and screwed on, each axis: an assumption
# What an autofocus does to focal length and centre (the scenario workshop has the source); sigma of a draw.
TOLD_FOCAL, TOLD_CENTRE_PX = 0.0015, 1.0
CENTRE_PX = 5.0  # from the middle of a picture to where the lens's axis meets it: an assumption
# Where a person puts a board that should face the camera: tilt about each axis, and off the line of sight.
TILT_RAD, ASIDE_M, TURN_RAD = 0.25, 0.03, 0.6
# Corners of real boards scatter by 0.15 to 0.3 px. The light that corners lose and the noise of the grey are
# the assumptions of the shipped scenarios, which have the same sizes.
PICTURE = {
    "noise_px": 0.2,
    "noise_grey": 3.0,
    "vignette": 0.3,
    "stamp_jitter_s": 0.0002,
}
# What a colour sensor with a rolling shutter takes for all rows of its modes up to 1080, and of larger ones
# (Luxonis, IMX378). One with a global shutter says row_time_s = 0 in its section.
ROWS_S, LARGE_ROWS_S, LARGE = 0.0167, 0.033, 1080
# Luxonis' figures for the clocks of camera and PC do not tell how much of them stays: here the stamps of a
# twin scatter by that of USB (``stamp_jitter_s``), and all are off by a draw of the size that jobs go by.
# The OAK-D's pair by its data sheet, with its sensors' pixels binned in pictures 400 high; noise and holes
# are assumptions. Depth is within 2 % of the distance (Luxonis), here two standard deviations of a draw.
STEREO = {"baseline_m": 0.075, "noise_px": 0.1, "holes": 0.05}
PAIR_PX, BINNED, BINNED_PX = 880.0, 400, 440.0  # focal lengths
STEREO_SCALE = 0.01
SERIAL = "99992200001"


def draw_camera(known: KnownCamera, arm: Chain, rng: np.random.Generator) -> dict[str, Any]:
    """``camera``, ``target``, ``target_print`` and ``placement`` of a scenario's world."""
    off = RigidTransform.from_components(
        MOUNT_M * rng.standard_normal(3), Rotation.from_rotvec(MOUNT_RAD * rng.standard_normal(3))
    )
    mount = from_pose6(known.T_mount_camera) * off
    told = known.pictures
    pixels = larger(told.width, told.height)  # of these pictures in one of the sizes here
    centre = np.array([told.width, told.height]) / 2 + pixels * rng.normal(0.0, CENTRE_PX, 2)
    focal = usual_K(told.width, told.height)[0]
    camera = {
        "serial": SERIAL,
        "width": told.width,
        "height": told.height,
        "K": [focal, focal, *centre.tolist()] if told.lens is None else list(told.lens.K),
        "dist": DIST if told.lens is None else list(told.lens.dist),
        **PICTURE,
        **_timing(told),
        "T_base_camera" if known.fixed else "T_flange_camera": to_pose6(mount).tolist(),
        "nominal": list(known.T_mount_camera),
        "told": {
            "focal": float(TOLD_FOCAL * rng.standard_normal()),
            "centre_px": (pixels * TOLD_CENTRE_PX * rng.standard_normal(2)).tolist(),
        },
    }
    # Drawn from a generator of its own, so that the places stay those of the seed.
    scale = 1.0 + STEREO_SCALE * float(rng.spawn(1)[0].standard_normal())
    camera |= {"stereo": {**_pair(told), "scale": scale}} if told.depth else {"depth": False}
    camera["stamp_late_s"] = CAMERA.sigma_s * float(rng.spawn(1)[0].standard_normal())
    return {
        "camera": camera,
        "target": dict(known.target),
        "target_print": {
            "scale_x": float(known.scale_sigma * rng.standard_normal()),
            "scale_y": float(known.scale_sigma * rng.standard_normal()),
            "bow_m": float(known.flatness_m * rng.uniform(-1.0, 1.0)),
            "bow_rad": float(rng.uniform(0.0, np.pi)),
        },
        "placement": [_placement(known, mount, arm, q, i, rng) for i, q in enumerate(known.looks)],
    }


def _pair(told: KnownPictures) -> dict[str, Any]:
    focal = BINNED_PX if told.stereo_height == BINNED else PAIR_PX
    return {**STEREO, "focal_px": focal, "steps": 2 ** (told.stereo_subpixel_bits or 3)}


def _timing(told: KnownPictures) -> dict[str, Any]:
    """When frames come, how long they are exposed, and when each row is."""
    rows_s = ROWS_S if told.height <= LARGE else LARGE_ROWS_S
    exposure: dict[str, Any] = (
        {"auto_exposure": {}} if told.exposure_s is None else {"exposure_s": told.exposure_s}
    )
    return {
        "period_s": 1.0 / told.fps,
        "row_time_s": rows_s / told.height if told.row_time_s is None else told.row_time_s,
        **exposure,
    }


def _placement(
    known: KnownCamera,
    mount: RigidTransform,
    arm: Chain,
    q_look: Sequence[float],
    number: int,
    rng: np.random.Generator,
) -> dict[str, Any]:
    if known.fixed:
        if known.T_flange_target is None:
            raise ValueError("a fixed camera needs [robot] T_flange_target_nominal")
        nominal = from_pose6(known.T_flange_target)
        if (t := known.target_sigma_t_m) is not None and (r := known.target_sigma_r_rad) is not None:
            shift, turn = t * rng.standard_normal(3), Rotation.from_rotvec(r * rng.standard_normal(3))
            return {
                "T_flange_target": to_pose6(RigidTransform.from_components(shift, turn) * nominal).tolist()
            }
        turned = Rotation.from_rotvec([0.0, 0.0, TURN_RAD * number]) * Rotation.from_rotvec(
            MOUNT_RAD * rng.standard_normal(3)
        )
        off = RigidTransform.from_components(MOUNT_M * rng.standard_normal(3), turned)
        return {"T_flange_target": to_pose6(nominal * off).tolist()}
    tilt = Rotation.from_rotvec([*(TILT_RAD * rng.uniform(-1.0, 1.0, 2)), TURN_RAD * rng.uniform(-1.0, 1.0)])
    middle = np.array([*(ASIDE_M * rng.uniform(-1.0, 1.0, 2)), known.distance_m])
    # A marker's z points out of it, the z of other targets into them.
    facing = Rotation.from_euler("x", np.pi if known.target["type"] == "aruco-marker" else 0.0)
    turned = tilt * facing
    corner = middle - turned.apply(_middle(known.target))
    seen = RigidTransform.from_components(corner, turned)
    base = arm.forward(np.array(q_look)) * mount * seen
    return {"T_base_target": to_pose6(base).tolist()}


def _middle(target: Any) -> Array:
    """(3,) m: the middle of a board in its own frame, whose origin is a corner; a marker's is its middle."""
    for across, down, size in (("squares_x", "squares_y", "square_m"), ("columns", "rows", "square_m")):
        if across in target:
            return np.array([target[across], target[down], 0.0]) * float(target[size]) / 2.0
    return np.zeros(3)
