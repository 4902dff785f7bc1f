"""Every block from thousands of poses: what is hardly known stays where its prior and the data have it."""

import numpy as np
from scipy.spatial.transform import RigidTransform

from calibration.adjustment.hand_eye import adjust
from calibration.adjustment.unknowns import ArmKnown
from calibration.hand_eye import se3
from calibration.hand_eye.solution import Solution, solve
from tests.kit import imperfect_cell
from tests.kit.imperfect_cell import ARM, CAMERA, MODEL, X_NOMINAL

TIMES = 25  # each pose, every time with noise of its own


def test_arm_target_and_camera_do_not_shrink_together_with_the_number_of_poses() -> None:
    rng = np.random.default_rng([0, 5])
    cell = imperfect_cell.world(rng, 2e-4, "exact", "exact", joints=11)
    measured, Q = imperfect_cell.capture(rng, cell, "diverse")
    placements: list[list[imperfect_cell.Seen]] = [[] for _ in range(measured.group.max() + 1)]
    for k, view in enumerate(measured.views):
        assert view is not None
        assert view.start is not None
        W = RigidTransform.from_matrix(measured.F[k] @ X_NOMINAL.as_matrix() @ view.start)
        own = placements[measured.group[k]]
        own += [imperfect_cell.seen_from(rng, cell, Q[k], W, view.start) for _ in range(TIMES)]
    measured, Q = imperfect_cell.gathered(placements)
    first = solve(measured, CAMERA, {})
    assert isinstance(first, Solution)
    found = adjust(measured, first, CAMERA, ArmKnown(MODEL, Q, ARM.joint_limits))
    size = found.names.index("scale_x")
    assert abs(found.numbers[size]) < 4.0 * found.sigma[size]
    assert found.components.scale["geometry"] < 3.0
    off = se3.log(se3.inverse(found.X) @ cell.X)[:3]
    assert np.linalg.norm(off) < 4.0 * np.sqrt(np.trace(found.cov[:3, :3]))
