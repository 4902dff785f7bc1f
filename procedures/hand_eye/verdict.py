"""The verdict of a capture: what the solver says of its data, held against the limits of the job."""

from pathlib import Path
from typing import Any

import numpy as np

from calibration.planning.prediction import PredictedUncertainty
from cell.formats.result import Result, Warning_
from procedures.hand_eye.config import Acceptance
from procedures.hand_eye.result import HandEyeResult
from procedures.hand_eye.result_spread import NeighbourSpread, PlainSpread
from procedures.hand_eye.solve.solver import solve_hand_eye
from procedures.words import deg, mm

TASK_CLEARANCE = "task.clearance"


def solve_within_limits(path: Path, limits: Acceptance) -> HandEyeResult | Result:
    """The result of a capture, judged; for the worker process."""
    return judged(solve_hand_eye(path, calls=1), limits)


def error_so_far(path: Path) -> dict[str, Any] | None:
    """The 95 % errors of an unfinished capture, by cause; None while its data determine no answer."""
    found = solve_hand_eye(path, calls=1)
    if not isinstance(found, HandEyeResult) or found.result.cov is None:
        return None
    sure = PredictedUncertainty(np.array(found.result.cov))
    return {
        "error95_t_m": sure.error95_t_m,
        "error95_r_rad": sure.error95_r_rad,
        "budget": [part.model_dump() for part in found.result.budget or []],
    }


def judged(found: HandEyeResult | Result, limits: Acceptance) -> HandEyeResult | Result:
    """``found`` with the 95 % errors of X, and with verdict ``fail`` where one is beyond its limit.

    A result beyond a limit stays filled; the reason names the limit. One without covariance fails, too: an
    unknown error fails the limit. The length that 95 % of the errors stay below comes from the covariance.
    The unweighted spreads are held against limits of their own where these are given, and the accuracy where
    the result is to be used against the task's clearance.
    """
    if not isinstance(found, HandEyeResult):
        return found
    spread, beyond = _spread_judged(found.result.neighbour_spread, limits)
    found = found.changed(result=found.result.changed(neighbour_spread=spread)) if spread else found
    if limits.clearance_m is not None:
        found = _graded(found, limits.clearance_m)
    if found.uncertainty.cov is None:
        unknown = (
            "no covariance was found, so the errors cannot be held against max_error_t_m and max_error_r_rad"
        )
        return found.judged([unknown, *beyond])
    sure = PredictedUncertainty(np.array(found.uncertainty.cov))
    checks = (
        ("max_error_t_m", sure.error95_t_m, limits.max_error_t_m, 1e3, "mm"),
        ("max_error_r_rad", sure.error95_r_rad, limits.max_error_r_rad, float(np.degrees(1.0)), "deg"),
    )
    reasons = [
        f"{name}: 95 % of the errors stay below {error * scale:.3g} {unit}, "
        f"the limit is {limit * scale:.3g} {unit}"
        for name, error, limit, scale, unit in checks
        if not error <= limit
    ]
    uncertainty = found.uncertainty.changed(error95_t_m=sure.error95_t_m, error95_r_rad=sure.error95_r_rad)
    return found.changed(uncertainty=uncertainty).judged([*reasons, *beyond])


def _graded(found: HandEyeResult, clearance_m: float) -> HandEyeResult:
    """``found`` with the grade of its accuracy at the task's place."""
    task = found.result.task
    if task is None:
        return found.judged(
            ["clearance_m: nothing is known of the accuracy at task_pose, as the arm's errors were not found"]
        )
    within = [length <= clearance_m for length in (task.configured95, task.corrected95)]
    grade = "pass" if within[0] else "warn" if within[1] else "fail"
    graded = task.changed(clearance_m=clearance_m, grade=grade)
    found = found.changed(result=found.result.changed(task=graded))
    if grade == "pass":
        return found
    if grade == "warn":
        text = (
            f"at task_pose 95 % of the errors stay below {mm(task.configured95)} with the arm as configured, "
            f"the clearance is {mm(clearance_m)}; with the corrected arm in result.robot they stay below "
            f"{mm(task.corrected95)}: use that arm"
        )
        return found.judged([], Warning_.each([(TASK_CLEARANCE, text)]))
    return found.judged(
        [
            f"clearance_m: at task_pose 95 % of the errors stay below {mm(task.corrected95)} even with the "
            f"corrected arm, the clearance is {mm(clearance_m)}"
        ]
    )


def _spread_judged(
    spread: NeighbourSpread | None, limits: Acceptance
) -> tuple[NeighbourSpread | None, list[str]]:
    """The unweighted spreads with their verdict in words, and what is not within a limit."""
    told, beyond = [], []
    for where in ("within", "across"):
        one: PlainSpread | None = getattr(spread, where, None)
        for kind, value, show in (
            ("t_m", None if one is None else one.t_norm, mm),
            ("r_rad", None if one is None else one.r, deg),
        ):
            name = f"max_spread_{where}_{kind}"
            limit: float | None = getattr(limits, name)
            if limit is None:
                continue
            if value is None:
                why = f"too few poses or placements for a spread {where} placements"
                beyond.append(f"{name}: {(spread and spread.not_determined) or why}")
            else:
                text = f"{where} placements {show(value)}, the limit is {show(limit)}"
                told.append(text)
                beyond += [] if value <= limit else [f"{name}: unweighted spread {text}"]
    if spread is None or not (told or beyond):
        return spread, beyond
    words = "not within their limits" if beyond else "within their limits"
    return spread.changed(verdict=f"{words}: {'; '.join(told)}" if told else words), beyond
