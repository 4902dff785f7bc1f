"""The standard of an eye-to-hand check beside the twin's truth."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from calibration.planning.prediction import PredictedUncertainty
from cell.poses import from_pose6, log_xi
from procedures.beside_truth import SURE_POSE, Judged, all_inside, limit_of_worst
from procedures.eye_to_hand.result import AxbcResult, DrivenTargets
from procedures.twin_arm import true_flange
from procedures.words import deg, mm

_RADIUS95 = 2.795  # standard deviations that 95 % of normal 3-vectors are shorter than


def judge_standard(result: AxbcResult, truth: Mapping[str, Any], folder: Path) -> Judged:
    """Good when the error of ``T_camera_base`` is within its own covariance, and targets that were driven to
    are truly off as stated: each of the two is in ``SURE`` of good runs.

    Each of ``of95`` is below 1 in 95 % of good runs: how far ``T_camera_base`` is shifted and turned, by the
    lengths and angles of its covariance, and the worst arrival where targets were driven to. All three are
    below in 85 % at least.
    """
    answer = result.result
    xi = log_xi(from_pose6(answer.T_camera_base).inv() * from_pose6(truth["T_base_camera"]).inv())
    cov = np.array(answer.cov)
    m2 = float(xi @ np.linalg.solve(cov, xi))
    good = m2 <= SURE_POSE
    sigma = [float(np.sqrt(np.trace(cov[part, part]))) for part in (slice(0, 3), slice(3, 6))]
    off = f"{mm(float(np.linalg.norm(xi[:3])))}, {deg(float(np.linalg.norm(xi[3:])))}"
    words = "consistent with" if good else "NOT consistent with"
    text = (
        f"T_camera_base is off by {off}; squared Mahalanobis distance {m2:.1f} (6 expected, limit "
        f"{SURE_POSE:.1f}): {words} the stated uncertainty\nblamed: {answer.blamed}"
    )
    stated = f"standard uncertainty {mm(sigma[0])}, {deg(sigma[1])}"
    of = PredictedUncertainty(cov)
    limits95 = {"translation": (of.error95_t_m, "m"), "rotation": (of.error95_r_rad, "rad")}
    of95 = {
        "translation": float(np.linalg.norm(xi[:3])) / of.error95_t_m,
        "rotation": float(np.linalg.norm(xi[3:])) / of.error95_r_rad,
    }
    if answer.driven is not None:
        found = _judge_driven(answer.driven, truth)
        good, text = good and found.good, f"{text}\n{found.text}"
        of95, limits95 = {**of95, **found.of95}, {**limits95, **found.limits95}
    return Judged(good, text, stated, off, all_inside(of95), of95, limits95)


@dataclass(frozen=True)
class DrivenTruth:
    """``shares``: of each arrival by how much what is stated is wrong, in units of its 95 %, which is one of
    ``bounds`` (m). ``true``: how far each target truly was off (m), by its number, ``before`` and
    ``after``."""

    shares: list[float]
    bounds: list[float]
    true: dict[str, dict[int, float]]


def driven_truth(driven: DrivenTargets, truth: Mapping[str, Any]) -> DrivenTruth:
    """Each arrival beside where the target truly was at the joints at which the arm rested; how well the arm
    repeats a pose, in place and in angle over the lever to the target, is not in its joints, so that is
    allowed for beside what is stated."""
    mechanical = truth["mechanical"]
    camera = from_pose6(mechanical["T_base_camera"]).inv()
    place = from_pose6(mechanical["T_flange_target"][0])
    noise, lever_m = truth["noise"], float(np.linalg.norm(place.translation))
    repeats = _RADIUS95 * np.hypot(noise["sigma_flange_t"], noise["sigma_flange_r"] * lever_m)
    shares: list[float] = []
    bounds: list[float] = []
    true: dict[str, dict[int, float]] = {"before": {}, "after": {}}
    for target in driven.targets:
        wanted = (from_pose6(target.T_camera_flange) * place).translation
        for how, seen in (("before", target.before), ("after", target.after)):
            if seen is None or seen.q is None:
                continue
            flange = true_flange(truth["robot"], np.array([seen.q]))[0]
            at = camera.apply(flange[:3, :3] @ place.translation + flange[:3, 3])
            true[how][target.number] = float(np.linalg.norm(at - wanted))
            bounds.append(float(np.hypot(seen.off_95_m, repeats)))
            shares.append(float(np.linalg.norm(at - wanted - seen.off)) / bounds[-1])
    return DrivenTruth(shares, bounds, true)


def _judge_driven(driven: DrivenTargets, truth: Mapping[str, Any]) -> Judged:
    """Good when all arrivals are as stated within limits that ``SURE`` of good runs keep.

    Which of the two ways is called nearer, by two standard deviations, is told and not judged: where nothing
    is gained, chance alone makes such a call in 2.3 % of good runs.
    """
    found = driven_truth(driven, truth)
    shares, true, n = found.shares, found.true, len(found.shares)
    if not shares:
        return Judged(True, "no target was seen", "", "")
    both = sorted(true["before"].keys() & true["after"].keys())
    before, after = (np.sqrt(np.mean([true[how][k] ** 2 for k in both] or [0.0])) for how in true)
    good = max(shares) <= limit_of_worst(n, sure=True)
    words = "consistent with" if good else "NOT consistent with"
    text = (
        f"targets are truly {mm(float(before))} off as given and {mm(float(after))} corrected (RMS of those "
        f"seen both ways); the worst of {n} arrivals is stated {max(shares):.2f} of its 95 % wrong, and of "
        f"{n} the worst is below {limit_of_worst(n):.2f} in 95 % of good runs: {words} what is stated"
    )
    if driven.better:
        text += f"\ncorrected is called surely nearer, and truly is{'' if after < before else ' NOT'}"
    name, worst = f"the worst of {n} arrivals", int(np.argmax(shares))
    of95 = {name: shares[worst] / limit_of_worst(n)}
    limits95 = {name: (found.bounds[worst] * limit_of_worst(n), "m")}
    return Judged(good, text, "", "", all_inside(of95), of95, limits95)
