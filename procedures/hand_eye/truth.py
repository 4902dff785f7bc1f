"""A hand-eye calibration, and what it says of the arm, beside the twin's truth."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import degrees, sqrt
from pathlib import Path
from typing import Any

import numpy as np

from calibration.adjustment.arm_terms import REFERENCE, reference_joints
from calibration.adjustment.gauge import apart
from calibration.kinematics.families import arm_spec
from cell.errors import error
from cell.formats.robot import parse_robot
from cell.poses import Array, from_pose6, log_xi
from cell.store.files import read_json
from procedures.beside_truth import SURE_MODE, SURE_POSE, Judged, all_inside
from procedures.hand_eye.record import CAPTURE_FILE
from procedures.hand_eye.result import ArmError, ArmFromBoard, HandEyeAnswer, HandEyeResult
from procedures.hand_eye.words import SETUPS, spread_lines
from procedures.twin_arm import true_flange
from procedures.words import table

_OWN_JOINTS = 1234  # others than those that the estimate is judged by
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
        return self.m2 <= SURE_POSE


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
    arm = None
    if result.result.arm is not None and result.result.robot is not None:
        configured = read_json(folder / CAPTURE_FILE)["robot"]
        arm = judge_corrected(result.result.arm, result.result.robot, truth["robot"], configured)
    text, limits95 = judgement_text(judgement, result.result), _limits95(result)
    sizes = {"translation": float(np.linalg.norm(off[:3])), "rotation": float(np.linalg.norm(off[3:]))}
    of95 = {name: sizes[name] / limit for name, (limit, _) in limits95.items()}
    return Judged(
        judgement.good and (arm is None or arm.good),
        text if arm is None else f"{text}\n{arm.text}",
        f"standard uncertainty {_size_text(sigma)}",
        _size_text(off),
        all_inside(of95),
        of95,
        limits95,
    )


def _limits95(result: HandEyeResult) -> dict[str, tuple[float, str]]:
    """What is stated of translation and rotation; nothing where nothing is."""
    t95, r95 = result.uncertainty.error95_t_m, result.uncertainty.error95_r_rad
    return {} if t95 is None or r95 is None else {"translation": (t95, "m"), "rotation": (r95, "rad")}


def judge_corrected(
    stated: ArmFromBoard,
    corrected: Mapping[str, Any],
    true: Mapping[str, Any],
    configured: Mapping[str, Any],
) -> Judged:
    """The arm's accuracy as ``stated`` beside that of the twin's arm, ``robot`` of its truth.

    ``configured`` and ``corrected``: the ROBOT before and after the calibration. Good when the true error of
    the corrected one is within what is stated, widened for errors that may all lie in one direction.
    """
    found = arm_beside_truth(stated, corrected, true, configured)
    after = found[-1]
    good = after.rms <= SURE_MODE * after.stated.t
    words = "consistent with" if good else "NOT consistent with"
    rows = [
        (row.name, *(f"{1e3 * v:.4f}" for v in (row.stated.t, row.rms, row.stated.t95, row.p95)))
        for row in found
    ]
    text = [
        f"the arm over all its joints, at {2**REFERENCE} that were not measured; position of the flange "
        "after the best base and flange, mm",
        table(("arm", "stated RMS", "true RMS", "stated: 95 % below", "true: 95 % below"), rows),
        f"the corrected arm is {words} what is stated of it (limit {SURE_MODE:.2g} times the stated RMS)",
    ]
    claim, off = (f"{1e3 * v:.3f} mm" for v in (after.stated.t, after.rms))
    return Judged(good, "\n".join(text), f"arm {claim} RMS", off)


@dataclass(frozen=True)
class ArmBesideTruth:
    """An arm's position errors (m) over joints that were not measured: RMS and 95 %, and as ``stated``."""

    name: str
    stated: ArmError
    rms: float
    p95: float


def arm_beside_truth(
    stated: ArmFromBoard,
    corrected: Mapping[str, Any],
    true: Mapping[str, Any],
    configured: Mapping[str, Any],
) -> list[ArmBesideTruth]:
    """The arm as configured and as corrected, after the best base and flange."""
    Q = reference_joints(np.tile([-np.pi, np.pi], (6, 1)), seed=_OWN_JOINTS)
    flange = true_flange(true, Q)
    rows = []
    for name, robot, told in (
        ("as configured", configured, stated.configured),
        ("as corrected", corrected, stated.corrected),
    ):
        arm = arm_spec(parse_robot(robot, "robot")).arm.base
        e = np.linalg.norm(apart(arm.flange(Q), flange)[:, :3], axis=1)
        rows.append(ArmBesideTruth(name, told, float(np.sqrt(np.mean(e**2))), float(np.percentile(e, 95))))
    return rows


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
            f"(6 expected, limit {SURE_POSE:.1f}; {sqrt(judgement.m2):.1f} sigma): {answer_word} the stated "
            "uncertainty",
            *spread_lines(answer),
            "The spreads tell how consistent single estimates are; they are not the error above.",
        ]
    )
