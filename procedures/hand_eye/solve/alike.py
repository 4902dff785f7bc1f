"""Placements that are one place: a board that was not moved between them."""

from collections.abc import Sequence

import numpy as np
from scipy.spatial import KDTree

from calibration.hand_eye import se3
from cell.poses import Array

CODE = "placements.alike"
SAME_T, SAME_R = 0.01, 0.035  # m, rad: as the job's new_place_t_m and new_place_r_rad


def alike_warnings(W: Array, labels: Sequence[str], parent: str) -> list[tuple[str, str]]:
    """``W`` (g, 4, 4): the target of each placement in ``parent``; a warning where some stand alike."""
    near = KDTree(W[:, :3, 3]).query_pairs(SAME_T, output_type="ndarray")
    i, k = near[np.lexsort((near[:, 1], near[:, 0]))].T
    turned = np.linalg.norm(se3.rotation_vectors(np.swapaxes(W[i, :3, :3], 1, 2) @ W[k, :3, :3]), axis=1)
    alike = turned < SAME_R
    pairs = [f"{labels[a]} and {labels[b]}" for a, b in zip(i[alike], k[alike], strict=True)]
    if not pairs:
        return []
    more = f" and {len(pairs) - 8} more" if len(pairs) > 8 else ""
    text = (
        f"the target stands at the same place in the {parent} in placements {', '.join(pairs[:8])}{more}: "
        "they are one placement, and the spread across placements does not show the arm's errors"
    )
    return [(CODE, text)]
