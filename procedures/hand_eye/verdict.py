"""The verdict of a capture: what the solver says of its data, held against the limits of the job."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from calibration.planning.prediction import PredictedUncertainty
from procedures.hand_eye.solve.solver import solve_hand_eye


def solve_within_limits(path: Path, limits: Mapping[str, Any]) -> dict[str, Any]:
    """``cellward.result/1`` of a capture, judged; for the worker process."""
    return judged(solve_hand_eye(path, calls=1), limits)


def error_so_far(path: Path) -> dict[str, Any] | None:
    """The 95 % errors of an unfinished capture, by cause; None while its data determine no answer."""
    found = solve_hand_eye(path, calls=1)
    answer: Any = found["result"]
    if answer is None or answer["cov"] is None:
        return None
    sure = PredictedUncertainty(np.array(answer["cov"]))
    return {
        "error95_t_m": sure.error95_t_m,
        "error95_r_rad": sure.error95_r_rad,
        "budget": answer.get("budget", []),
    }


def judged(result: Mapping[str, Any], limits: Mapping[str, Any]) -> dict[str, Any]:
    """``result`` with the 95 % errors of X, and with verdict ``fail`` where one is beyond its limit.

    ``limits`` has ``max_error_t_m`` and ``max_error_r_rad``. A result beyond a limit stays filled; the
    reason names the limit. One without covariance fails too: what is not known is within no limit. The
    length that 95 % of the errors stay below comes from the covariance.
    """
    cov = result["uncertainty"].get("cov")
    if result["result"] is None:
        return dict(result)
    if cov is None:
        unknown = (
            "no covariance was found, so the errors cannot be held against max_error_t_m and max_error_r_rad"
        )
        return {**result, "verdict": "fail", "reasons": [unknown, *result["reasons"]]}
    sure = PredictedUncertainty(np.array(cov))
    checks = (
        ("max_error_t_m", sure.error95_t_m, 1e3, "mm"),
        ("max_error_r_rad", sure.error95_r_rad, float(np.degrees(1.0)), "deg"),
    )
    reasons = [
        f"{name}: 95 % of the errors stay below {found * scale:.3g} {unit}, "
        f"the limit is {limits[name] * scale:.3g} {unit}"
        for name, found, scale, unit in checks
        if not found <= limits[name]
    ]
    return {
        **result,
        "verdict": "fail" if reasons else result["verdict"],
        "reasons": [*reasons, *result["reasons"]],
        "uncertainty": {
            **result["uncertainty"],
            "error95_t_m": sure.error95_t_m,
            "error95_r_rad": sure.error95_r_rad,
        },
    }
