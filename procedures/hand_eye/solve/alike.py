"""Placements that are one place: a board that was not moved between them."""

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import RigidTransform

from cell.poses import Array

CODE = "placements.alike"
SAME_T, SAME_R = 0.01, 0.035  # m, rad: as the job's new_place_t_m and new_place_r_rad


def alike_warnings(W: Array, labels: Sequence[str], parent: str) -> list[tuple[str, str]]:
    """``W`` (g, 4, 4): the target of each placement in ``parent``; a warning where some stand alike."""
    poses = [RigidTransform.from_matrix(T) for T in W]
    pairs = []
    for i in range(len(poses)):
        for k in range(i + 1, len(poses)):
            step = poses[i].inv() * poses[k]
            if np.linalg.norm(step.translation) < SAME_T and step.rotation.magnitude() < SAME_R:
                pairs.append(f"{labels[i]} and {labels[k]}")
    if not pairs:
        return []
    more = f" and {len(pairs) - 8} more" if len(pairs) > 8 else ""
    text = (
        f"the target stands at the same place in the {parent} in placements {', '.join(pairs[:8])}{more}: "
        "they are one placement, and the spread across placements does not show the arm's errors"
    )
    return [(CODE, text)]
