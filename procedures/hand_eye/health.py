"""Health numbers of a hand-eye calibration over the runs, and how far the camera moved since the last one."""

import numpy as np
from scipy.special import chdtri

from cell.poses import from_pose6, log_xi
from cell.procedure import Run
from procedures.hand_eye.result import HandEyeAnswer, HandEyeResult, MovedCamera
from procedures.trends import keep_trends

_CHANCE = 1e-3  # that a camera which stands still is said to have moved


async def keep_health(run: Run, setup: str, name: str) -> None:
    """Add what this run measured to the trends, and how far the camera moved to the result.

    ``name`` is the calibration that the run makes; a version of it that is in effect is compared with.
    """
    if not isinstance(run.result, HandEyeResult):
        return
    answer, since = run.result.result, None
    if name in run.values.versions:
        before = (run.values.calibration[setup] or {}).get("X")
        if before is not None:
            since = moved(answer, before, run.values.versions[name])
            run.result = run.result.with_inputs(moved=since)
    await keep_trends(run, _numbers(name, answer, since))


def moved(answer: HandEyeAnswer, before: list[float], version: int) -> MovedCamera | None:
    """How far the camera is from where ``version`` has it; None without a covariance to judge that by.

    The version is taken to be as uncertain as the answer, so their difference has twice its covariance.
    """
    pose = answer.pose()
    if answer.cov is None or pose is None:
        return None
    xi = log_xi(from_pose6(pose[1]).inv() * from_pose6(before))
    squared = float(xi @ np.linalg.solve(2.0 * np.array(answer.cov), xi))
    return MovedCamera(
        version=version,
        t=float(np.linalg.norm(xi[:3])),
        r=float(np.linalg.norm(xi[3:])),
        beyond_uncertainty=squared > float(chdtri(6, _CHANCE)),
        false_alarm=_CHANCE,
    )


def _numbers(name: str, answer: HandEyeAnswer, since: MovedCamera | None) -> dict[str, float | None]:
    within, across = answer.spread_within, answer.spread_across
    return {
        f"hand_eye.noise_px.{name}": answer.noise.sigma_px,
        f"hand_eye.moved_m.{name}": None if since is None else since.t,
        f"hand_eye.arm_m.{name}": None if answer.arm is None else answer.arm.configured.t,
        f"hand_eye.spread_within_m.{name}": None if within is None else within.t_norm,
        f"hand_eye.spread_across_m.{name}": None if across is None else across.t_norm,
    }
