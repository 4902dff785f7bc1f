"""Whether flange poses belong to the images; where they do not, the refusal names the likely mistake."""

import numpy as np
from numpy.typing import NDArray

from calibration.hand_eye.closed_form import pairs
from calibration.hand_eye.leave_out import spread_about_mean
from calibration.hand_eye.problem import Problem
from calibration.hand_eye.solution import Measurements, Solution
from cell.devices import Intrinsics
from cell.errors import error
from cell.poses import Array
from procedures.hand_eye.solve.arm import GivenArm
from procedures.hand_eye.solve.capture import FAR_T, UNITS_T, CaptureSet
from procedures.hand_eye.solve.joint_zero import CODE as ZERO
from procedures.hand_eye.solve.joint_zero import joint_zero
from procedures.hand_eye.solve.mistakes import GivenCapture, explained
from procedures.hand_eye.solve.other_order import FEWEST_ORDERED, exchanged
from procedures.hand_eye.solve.other_writing import TIME

_MISMATCH = 0.05  # rad, or a quarter of what the arm turned
_POOR_T, _POOR_R = 2e-3, 3e-3  # m, rad, of the target's poses: an arm in working order leaves less
_FAR_X = 5.0  # m; no camera is mounted that far from flange or base
_FAR_APART_T, _FAR_APART_R = 0.04, 0.05  # of the distance to the target; rad


def check_match(
    loaded: CaptureSet,
    rows: NDArray[np.int64],
    measured: Measurements,
    camera: Intrinsics | None,
    arm: GivenArm | None,
    solution: Solution,
) -> None:
    """Refuse flange poses that do not belong to the images, with the likely mistake and its code.

    Judged by the observations in use: a few that are wrong are blunders, and are listed.
    """
    problem = solution.problem.take(solution.used)
    if not (words := _disagreement(problem, solution.at.X)):
        return
    observations = [loaded.capture.observations[int(row)] for row in rows]
    given = GivenCapture(
        measured,
        camera,
        poses=np.array([o.T_base_flange for o in observations]),
        arm=None if arm is None else arm.spec.arm,
        Q=None if arm is None else arm.Q,
        size=None if camera is None else (camera.width, camera.height),
    )
    mistake = explained(given)
    if mistake is None:
        code = TIME
        cause = _unexplained(solution.problem.n)
    else:
        code, cause = mistake.code, mistake.text
    raise error(
        "DATA_INVALID",
        f"{loaded.path}: {code}: T_base_flange does not belong to the images: {words}; {cause}",
    )


def _unexplained(n: int) -> str:
    """What to look for in a set of ``n`` observations whose mistake was not found."""
    if n >= FEWEST_ORDERED:
        order = "some of the orders of the poses, not all of them"
    else:
        order = f"no other order, which fewer than {FEWEST_ORDERED} poses do not tell"
    return (
        "no single mistake was found that makes them fit; tried were the other setup, other units and Euler "
        f"angles in place of rotation vectors, with the numbers of this file, and {order}; check that each "
        "pose was recorded with its own image, and in an imported file the units and the order of angles"
    )


def _disagreement(problem: Problem, X: Array) -> str:
    """In words how far arm and images contradict each other; empty when they do not."""
    i, j = pairs(problem.group, 500)
    turned = []
    for T in (problem.G, problem.C):
        trace = np.sum(T[i, :3, :3] * T[j, :3, :3], axis=(1, 2))
        turned.append(np.arccos(np.clip((trace - 1.0) / 2.0, -1.0, 1.0)))
    mismatch = float(np.median(np.abs(turned[0] - turned[1])))
    if mismatch > max(_MISMATCH, 0.25 * float(np.median(turned[0]))):
        return (
            "between the same two observations arm and camera turn by angles that differ by "
            f"{np.degrees(mismatch):.1f} deg (median)"
        )
    t, r = spread_about_mean(problem.target_poses(X), problem.group)
    apart, turned_by = float(np.median(t)), float(np.median(r))
    reach = float(np.median(np.linalg.norm(problem.C[:, :3, 3], axis=1)))
    if apart < _FAR_APART_T * reach and turned_by < _FAR_APART_R:
        return ""
    return (
        f"with setup {problem.setup!r} the target's poses disagree by {apart:.3f} m and "
        f"{np.degrees(turned_by):.1f} deg (median), seen from {reach:.2f} m"
    )


def doubts(
    loaded: CaptureSet, rows: NDArray[np.int64], solution: Solution, arm: GivenArm | None
) -> list[tuple[str, str]]:
    """What to warn of in a set that agrees well enough to be solved: poses that were exchanged, times that
    are not in order, a joint whose zero is off."""
    index = [loaded.indices[int(row)] for row in rows]
    out = []
    swapped = exchanged(solution)
    if swapped:
        named = ", ".join(f"the pose of {index[k]} fits the image of {index[i]}" for i, k in swapped[:8])
        out.append((TIME, f"poses were exchanged among the observations that disagree: {named}"))
    times = [loaded.capture.observations[int(row)].t for row in rows]
    back = [k for k in range(1, len(times)) if _before(times[k], times[k - 1])]
    if back:
        k = back[0]
        text = f"observation {index[k]} is older than observation {index[k - 1]} before it"
        more = f" ({len(back)} such)" if len(back) > 1 else ""
        out.append((TIME, f"{text}{more}: make sure that poses and images are in the same order"))
    problem = solution.problem.take(solution.used)
    t, r = spread_about_mean(problem.target_poses(solution.at.X), problem.group)
    if arm is not None and (float(np.median(t)) > _POOR_T or float(np.median(r)) > _POOR_R):
        zero = joint_zero(problem, arm.spec.arm, arm.Q[solution.used])
        if zero is not None:
            out.append((ZERO, zero.text))
    return out


def _before(time: float | None, other: float | None) -> bool:
    return time is not None and other is not None and time < other


def check_units(loaded: CaptureSet, X: Array) -> None:
    """Refuse lengths in millimetres: the data agree with themselves, and only their size gives it away."""
    length = float(np.linalg.norm(X[:3, 3]))
    if length <= _FAR_X:
        return
    if not any(code == UNITS_T for code, _ in loaded.warnings):
        raise error(
            "DATA_INVALID",
            f"{loaded.path}: {UNITS_T}: the answer would be {length:.3g} m long, and no camera is mounted "
            f"more than {_FAR_X:g} m from flange or base; look whether the lengths of target or "
            "T_camera_target are in millimetres, and divide them by 1000",
        )
    raise error(
        "DATA_INVALID",
        f"{loaded.path}: {UNITS_T}: T_base_flange is more than {FAR_T:.0f} m from the base and the answer "
        f"would be {length:.3g} m long, so the lengths are in millimetres; divide the translations of "
        "T_base_flange and the lengths of target by 1000",
    )
