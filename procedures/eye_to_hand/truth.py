"""The standard of an eye-to-hand check beside the twin's truth."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from cell.poses import from_pose6, log_xi
from procedures.beside_truth import Judged
from procedures.eye_to_hand.result import AxbcResult
from procedures.words import deg, mm

M2_LIMIT = 20.1  # 99.73 % of a chi-square with 6 degrees of freedom lie below
M2_95 = 12.59  # 95 % do


def judge_standard(result: AxbcResult, truth: Mapping[str, Any], folder: Path) -> Judged:
    """Good when the error of ``T_camera_base`` is within its own covariance."""
    answer = result.result
    xi = log_xi(from_pose6(answer.T_camera_base).inv() * from_pose6(truth["T_base_camera"]).inv())
    cov = np.array(answer.cov)
    m2 = float(xi @ np.linalg.solve(cov, xi))
    good = m2 <= M2_LIMIT
    sigma = [float(np.sqrt(np.trace(cov[part, part]))) for part in (slice(0, 3), slice(3, 6))]
    off = f"{mm(float(np.linalg.norm(xi[:3])))}, {deg(float(np.linalg.norm(xi[3:])))}"
    words = "consistent with" if good else "NOT consistent with"
    text = (
        f"T_camera_base is off by {off}; squared Mahalanobis distance {m2:.1f} (6 expected, limit "
        f"{M2_LIMIT}): {words} the stated uncertainty\nblamed: {answer.blamed}"
    )
    stated = f"standard uncertainty {mm(sigma[0])}, {deg(sigma[1])}"
    of95 = {"distance by the covariance": float(np.sqrt(m2 / M2_95))}
    return Judged(good, text, stated, off, m2 <= M2_95, of95)
