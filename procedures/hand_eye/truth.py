"""A hand-eye calibration beside the twin's truth."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import degrees, sqrt
from pathlib import Path
from typing import Any

import numpy as np

from cell.errors import error
from cell.poses import Array, from_pose6, log_xi
from procedures.beside_truth import Judged
from procedures.hand_eye.result import HandEyeAnswer, HandEyeResult
from procedures.hand_eye.words import SETUPS, spread_lines
from procedures.words import table

M2_LIMIT = 20.1  # 3 sigma: 99.73 % of a chi-square with 6 degrees of freedom lie below
AXES = ("x", "y", "z", "about x", "about y", "about z")


@dataclass(frozen=True)
class Judgement:
    """A hand-eye answer against the truth: ``T_found exp(xi) = T_true``."""

    name: str
    found: Array  # (6,) pose, m and rad
    true: Array  # (6,)
    xi: Array  # (6,) translation first
    sigma: Array  # (6,) standard uncertainty of xi
    m2: float  # squared Mahalanobis distance of xi under the answer's own covariance

    @property
    def good(self) -> bool:
        return self.m2 <= M2_LIMIT


def judge(result: HandEyeResult, truth: Mapping[str, Any]) -> Judgement:
    """Compare an answer with the truth; ``SOLVE_REFUSED`` when it holds no pose."""
    held = result.result.pose()
    if held is None:
        raise error("SOLVE_REFUSED", "; ".join(result.reasons or ["there is no answer"]))
    name, pose = held
    found, true, cov = np.array(pose), np.array(truth[name]), np.array(result.result.cov)
    xi = log_xi(from_pose6(found).inv() * from_pose6(true))
    m2 = float(xi @ np.linalg.solve(cov, xi))
    return Judgement(name, found, true, xi, np.sqrt(np.diag(cov)), m2)


def judge_camera(result: HandEyeResult, truth: Mapping[str, Any], folder: Path) -> Judged:
    """Whether a hand-eye answer agrees with the true pose, and the table that shows it."""
    judgement = judge(result, truth)
    sigma, off = judgement.sigma, judgement.xi
    return Judged(
        judgement.good,
        judgement_text(judgement, result.result),
        f"standard uncertainty {_size_text(sigma)}",
        _size_text(off),
    )


def _size_text(xi: Array) -> str:
    t, r = float(np.linalg.norm(xi[:3])), float(np.linalg.norm(xi[3:]))
    return f"{1e3 * t:.3f} mm, {degrees(r):.4f} deg"


def judgement_text(judgement: Judgement, answer: HandEyeAnswer) -> str:
    """The table of the six components, the distance, and the two consistency figures."""
    scale = [1e3] * 3 + [degrees(1.0)] * 3
    rows = [
        (axis, *(f"{k * v[i]:.5f}" for v in (judgement.found, judgement.true, judgement.xi, judgement.sigma)))
        for i, (axis, k) in enumerate(zip(AXES, scale, strict=True))
    ]
    t, r = float(np.linalg.norm(judgement.xi[:3])), float(np.linalg.norm(judgement.xi[3:]))
    answer_word = "consistent with" if judgement.good else "NOT consistent with"
    return "\n".join(
        [
            f"{judgement.name}, {SETUPS[judgement.name]}; mm, and degrees of the rotation vector",
            table(("", "found", "truth", "error (camera frame)", "standard uncertainty"), rows),
            f"error {1e3 * t:.4f} mm, {degrees(r):.5f} deg",
            f"squared Mahalanobis distance of the error under its own covariance: {judgement.m2:.1f} "
            f"(6 expected, limit {M2_LIMIT}; {sqrt(judgement.m2):.1f} sigma): {answer_word} the stated "
            "uncertainty",
            *spread_lines(answer),
            "The spreads tell how consistent single estimates are; they are not the error above.",
        ]
    )
