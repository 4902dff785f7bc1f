"""Health numbers of a hand-eye calibration over the runs, and how far the camera moved since the last one."""

from typing import Any

import numpy as np
from scipy.special import chdtri

from cell.poses import from_pose6, log_xi
from cell.procedure import Run

_CHANCE = 1e-3  # that a camera which stands still is said to have moved


async def keep_trends(run: Run, setup: str, name: str) -> None:
    """Add what this run measured to the trends, and their histories to the result's inputs.

    ``name`` is the calibration that the run makes; a version of it that is in effect is compared with.
    """
    result = run.result
    if result is None or result["result"] is None:
        return
    inputs: dict[str, Any] = result["inputs"]
    if name in run.values.versions:
        before = (run.values.calibration[setup] or {}).get("X")
        if before is not None:
            inputs["moved"] = moved(result["result"], name, before, run.values.versions[name])
    inputs["trend"] = {
        key: [[t, v] for t, v in await run.cell.add_trend(key, value)]
        for key, value in _numbers(name, result["result"], inputs.get("moved")).items()
    }


def moved(answer: dict[str, Any], name: str, before: list[float], version: int) -> dict[str, Any] | None:
    """How far the camera is from where ``version`` has it; None without a covariance to judge that by.

    The version is taken to be as uncertain as the answer, so their difference has twice its covariance.
    """
    if answer["cov"] is None:
        return None
    xi = log_xi(from_pose6(answer[name]).inv() * from_pose6(before))
    squared = float(xi @ np.linalg.solve(2.0 * np.array(answer["cov"]), xi))
    return {
        "version": version,
        "t": float(np.linalg.norm(xi[:3])),
        "r": float(np.linalg.norm(xi[3:])),
        "beyond_uncertainty": squared > float(chdtri(6, _CHANCE)),
    }


def _numbers(name: str, answer: dict[str, Any], since: dict[str, Any] | None) -> dict[str, float]:
    found: dict[str, Any] = {
        f"hand_eye.noise_px.{name}": answer["noise"].get("sigma_px"),
        f"hand_eye.moved_m.{name}": None if since is None else since["t"],
        f"hand_eye.arm_m.{name}": (answer.get("arm") or {}).get("configured", {}).get("t"),
    }
    for where in ("within", "across"):
        found[f"hand_eye.spread_{where}_m.{name}"] = (answer[f"spread_{where}"] or {}).get("t_norm")
    return {key: float(value) for key, value in found.items() if value is not None}
