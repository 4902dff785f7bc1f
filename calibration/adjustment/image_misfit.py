"""What images ask of lens and target by themselves, where both are known as well as they are.

A camera that is fitted alone takes a bent target for a lens. Here both may differ from what was given, each
by what was to be expected of it, as in the adjustment that follows.
"""

from collections.abc import Sequence

import numpy as np

from calibration.adjustment.lens_terms import (
    LENS,
    TARGET,
    LensPrior,
    image_terms,
    moved_camera,
    target_shape,
)
from calibration.hand_eye.pnp import refine_poses, solve_pnp
from calibration.hand_eye.views import CornerSet
from cell.devices import Intrinsics
from cell.poses import Array

_ANY_BOW = 0.01  # m; a bow may be as large as it likes
_BOW = slice(len(LENS) + 2, len(LENS) + len(TARGET))
_ROUNDS = 4


def explained_by_parts(
    views: Sequence[CornerSet], camera: Intrinsics, lens: LensPrior, sigma_px: float
) -> tuple[float, Array]:
    """RMS distance in pixels over all corners, and by how much the lens (8,) differs from ``camera``.

    Each view has its own best pose, and all of them one bow of the target. The scale of a target moves no
    corner beside its pose and stays.
    """
    shape = target_shape(views)
    poses, owner = solve_pnp(views, camera)
    C = poses.take(np.unique(owner, return_index=True)[1]).C
    free = np.r_[: len(LENS), _BOW]
    precision = np.concatenate([lens.sigma(), np.full(_BOW.stop - _BOW.start, _ANY_BOW)]) ** -2.0
    numbers = np.zeros(len(LENS) + len(TARGET))
    now, seen = camera, list(views)
    for _ in range(_ROUNDS):
        terms = image_terms(seen, C, now, shape)
        info, pull = terms.info[np.ix_(free, free)], terms.pull[free]
        N = info / sigma_px**2 + np.diag(precision)
        numbers[free] -= np.linalg.solve(N, pull / sigma_px**2 + precision * numbers[free])
        now = moved_camera(camera, numbers[: len(LENS)])
        seen = [CornerSet(shape.moved(v.points, numbers[len(LENS) :]), v.corners, v.count) for v in views]
        found = refine_poses(seen, now, C)
        C = found.C
    rms = float(np.sqrt(found.sse.sum() / sum(v.count.sum() for v in views)))
    return rms, numbers[: len(LENS)]
