"""Poses as numbers and as transforms, against SciPy's own slower ways."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from cell.poses import compose, from_pose6, to_pose6

POSES = 0.5 * np.random.default_rng(4).normal(size=(5, 6))  # turns of less than half a turn


@pytest.mark.parametrize("poses", [POSES[0], POSES], ids=["one", "many"])
def test_a_pose_is_a_translation_and_a_rotation_vector(poses: np.ndarray) -> None:
    made = RigidTransform.from_components(poses[..., :3], Rotation.from_rotvec(poses[..., 3:]))
    subject = from_pose6(poses)
    assert subject.as_matrix() == pytest.approx(made.as_matrix(), abs=1e-14)
    assert subject.single == made.single
    assert to_pose6(subject) == pytest.approx(poses, abs=1e-12)


@pytest.mark.parametrize("first", [from_pose6(POSES[0]), from_pose6(POSES)], ids=["one", "many"])
def test_composed_transforms_are_their_product_and_leave_them_as_they_were(first: RigidTransform) -> None:
    second, third = from_pose6(POSES[1]), from_pose6(POSES[2])
    before = first.as_matrix()
    subject = compose(first, second, third)
    assert subject.as_matrix() == pytest.approx((first * second * third).as_matrix(), abs=1e-14)
    assert subject.single == first.single
    assert np.array_equal(first.as_matrix(), before)
