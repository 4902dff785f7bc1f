"""Views over a fixed camera's volume, and which others lie beyond them."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from calibration.planning import Volume, beyond_volume, candidate_views
from cell.devices import Intrinsics

VOLUME = Volume(16, 0.4, 0.7, 0.6)
POINTS = np.array([[0.0, 0.0, 0.0], [0.2, 0.0, 0.0], [0.0, 0.1, 0.0], [0.2, 0.1, 0.0]])
CENTRE = np.array([0.1, 0.05, 0.0])
LENS = Intrinsics(1280, 800, (800.0, 800.0, 639.5, 399.5), (0.0, 0.0, 0.0, 0.0, 0.0))
SEEN = RigidTransform.from_components([0.02, -0.05, 0.5], Rotation.from_euler("xyz", [0.1, -0.2, 0.4]))


def placed(ray: list[float], distance: float, roll: float, tilt: float) -> RigidTransform:
    """The target's centre along ``ray``, rolled from how it is seen and tilted from facing the camera."""
    z = np.array(ray) / np.linalg.norm(ray)
    x = SEEN.rotation.as_matrix()[:, 0]
    x = x - (x @ z) * z
    x /= np.linalg.norm(x)
    facing = Rotation.from_matrix(np.column_stack([x, np.cross(z, x), z]))
    R = facing * Rotation.from_rotvec([0.0, 0.0, roll]) * Rotation.from_rotvec([0.6 * tilt, -0.8 * tilt, 0.0])
    return RigidTransform.from_components(distance * z - R.apply(CENTRE), R)


def test_no_view_of_the_plan_lies_beyond_it() -> None:
    views = candidate_views(VOLUME, SEEN, POINTS, LENS)
    assert len(views) == 8 * VOLUME.poses
    assert not any(beyond_volume(VOLUME, view, SEEN, POINTS) for view in views)


@pytest.mark.parametrize(
    ("distance", "roll", "tilt", "said"),
    [
        (0.41, 0.99, 0.59, None),
        (0.69, -0.99, -0.59, None),
        (0.38, 0.0, 0.0, "0.38 m before the camera, poses are from 0.4 to 0.7 m"),
        (0.72, 0.0, 0.0, "0.72 m before the camera, poses are from 0.4 to 0.7 m"),
        (0.5, 0.3, 0.7, "tilted by 40 degrees, poses are by up to 34"),
        (0.5, 1.2, 0.3, "rolled by 69 degrees from where the arm begins, poses are by up to 57"),
        (0.5, -1.2, 0.3, "rolled by 69 degrees from where the arm begins, poses are by up to 57"),
        (0.5, 3.1, 0.0, "rolled by 178 degrees from where the arm begins, poses are by up to 57"),
    ],
)
def test_what_lies_beyond_is_said(distance: float, roll: float, tilt: float, said: str | None) -> None:
    for ray in ([0.0, 0.0, 1.0], [0.3, -0.2, 1.0]):
        assert beyond_volume(VOLUME, placed(ray, distance, roll, tilt), SEEN, POINTS) == said
