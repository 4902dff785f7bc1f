"""Hand-eye calibration from a capture data set: the one path of jobs, replay and ``cellward solve``."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from calibration.hand_eye import se3
from calibration.hand_eye.ambiguity import turns
from calibration.hand_eye.classic import METHODS, jackknife, solve_classic
from calibration.hand_eye.problem import Estimate
from calibration.hand_eye.solution import Measurements, Solution, solve
from calibration.refusal import Refusal
from cell.errors import error
from cell.formats.result import Result
from procedures.hand_eye.known_parts import NO_ARM
from procedures.hand_eye.result import HandEyeResult
from procedures.hand_eye.solve.adjustment import METHOD as ADJUSTMENT
from procedures.hand_eye.solve.adjustment import by_adjustment, why_not
from procedures.hand_eye.solve.alike import alike_warnings
from procedures.hand_eye.solve.arm import given_arm
from procedures.hand_eye.solve.camera import CameraChoice, check_views, choose_camera
from procedures.hand_eye.solve.capture import CaptureSet, load_capture
from procedures.hand_eye.solve.copies import leave_copies_out
from procedures.hand_eye.solve.match import check_match, check_units, doubts
from procedures.hand_eye.solve.neighbours import CLASSIC, CLASSIC_LEAST_SQUARES, neighbours_of
from procedures.hand_eye.solve.order_check import order_warnings
from procedures.hand_eye.solve.other_robot import with_robot
from procedures.hand_eye.solve.result import Adjustment, Solved, fill_result
from procedures.hand_eye.solve.target_check import side_warnings
from procedures.hand_eye.solve.target_size import size_factor, sized
from procedures.solving import Progress, refused, within_limits
from procedures.timed import timed

ML = "ml"
_MOST_CLASSIC = 1000  # a minute


@within_limits
def solve_hand_eye(
    path: Path,
    *,
    method: str | None = None,
    predict: Path | None = None,
    robot: Path | Mapping[str, Any] | None = None,
    progress: Progress | None = None,
    calls: int = 1,
) -> HandEyeResult | Result:
    """The result of a capture data set: its folder or its ``capture.json``.

    ``method`` is ``adjustment`` (weighted maximum likelihood with arm, lens and target as unknowns; the
    default for observations with corners), ``ml`` (the same with arm, lens and target as they are given; the
    default for bare poses), one of OpenCV's ``tsai``, ``park``, ``horaud``, ``daniilidis``, or the
    unweighted cone method: ``classic``, or ``classic-least-squares`` with its other means. ``predict`` is a
    ``cellward.capture-query/1``: joints whose flange poses are wanted. ``robot`` is a ROBOT, or the file of
    one: the flange poses are then its at the stored joints.
    ``progress(stage, done, total)`` is called now and then. ``solve_seconds`` is the shortest time of
    ``calls`` calls, for those who compare it. Bad input raises an ``InputError``; data that cannot determine
    the answer give a result with verdict ``fail``.
    """
    known_methods = (ADJUSTMENT, ML, *METHODS, CLASSIC, CLASSIC_LEAST_SQUARES)
    if method not in (None, *known_methods):
        known = ", ".join(known_methods)
        raise error("ARGUMENT_INVALID", f"method is {method!r}; it must be one of {known}")
    if predict is not None and method not in (None, ADJUSTMENT):
        raise error("ARGUMENT_INVALID", f"--predict needs method {ADJUSTMENT!r}; leave --method out")
    with one_thread():
        loaded = load_capture(Path(path), progress)
        if robot is not None:
            with_robot(loaded, robot)
        camera = choose_camera(loaded, adjusts=method in (None, ADJUSTMENT))
        check_views(loaded, camera.camera)
        if progress is not None:
            progress("solve", 0, 1)
        result = _solve(loaded, camera, method, predict, calls)
        if progress is not None:
            progress("solve", 1, 1)
    return result


@contextmanager
def one_thread() -> Iterator[None]:
    """OpenCV on one thread: sums are then made in the same order every time."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)


def _solve(
    loaded: CaptureSet, camera: CameraChoice, asked: str | None, predict: Path | None, calls: int
) -> HandEyeResult | Result:
    warnings = [*loaded.warnings, *camera.warnings]
    warnings += leave_copies_out(loaded)
    rows = loaded.usable()
    inputs: dict[str, Any] = {
        "setup": loaded.capture.setup,
        "method": asked or ADJUSTMENT,
        "observations": len(loaded.F),
        "usable": len(rows),
        "target": loaded.capture.target.model_dump(exclude_none=True),
        "noise_given": given_noise(loaded),
    }
    if not len(rows):
        reasons = sorted({r for r in loaded.unusable.values()})
        text = f"the target was seen in none of {len(loaded.F)} observations"
        refusal = Refusal("too-few-poses", f"{text} ({'; '.join(reasons) or 'there are none'})")
        return _refused(loaded, refusal, warnings, inputs)
    measured = measurements(loaded, rows)
    arm_of = given_arm(loaded, rows)
    solution, seconds = timed(lambda: solve(measured, camera.camera, given_noise(loaded)), calls)
    if isinstance(solution, Refusal):
        return _refused(loaded, solution, warnings, inputs)
    if (factor := size_factor(measured, solution)) != 1.0:
        measured = sized(measured, factor)
        solution, more_seconds = timed(lambda: solve(measured, camera.camera, given_noise(loaded)), calls)
        seconds += more_seconds
        if isinstance(solution, Refusal):
            return _refused(loaded, solution, warnings, inputs)
    inputs["solve_seconds"] = seconds
    neighbours = neighbours_of(loaded, rows, solution.problem)
    check_match(loaded, rows, measured, camera.camera, arm_of[0], solution)
    check_units(loaded, solution.at.X)
    warnings += side_warnings(loaded, solution.problem.take(solution.used))
    warnings += doubts(loaded, rows, solution, arm_of[0])
    if not _timed(loaded):
        warnings += order_warnings(solution)
    method, more = _method(loaded, rows, solution, measured, asked)
    inputs["method"] = method
    warnings += more
    cov: np.ndarray | None = solution.cov
    judged: Solution | None = None
    told: Adjustment | None = None
    if method == ADJUSTMENT:
        adjust = partial(by_adjustment, loaded, rows, measured, camera, arm_of, solution, factor, predict)
        found, more_seconds = timed(adjust, calls)
        inputs["solve_seconds"] = seconds + more_seconds
        solution, judged, measured = found.solution, found.judged, found.measured
        camera, told = found.camera, found.told
        cov, warnings = solution.cov, [*warnings, *found.warnings]
    elif method in (CLASSIC, CLASSIC_LEAST_SQUARES):
        solution, cov = _with_pose(solution, neighbours.pose(method)), None
    elif method != ML:
        solution, cov = _by_classic(solution, method)
    labels = [str(loaded.group[rows][solution.problem.group == g][0]) for g in solution.groups]
    parent = "base" if loaded.capture.setup == "eye-in-hand" else "flange"
    warnings = [*warnings, *alike_warnings(solution.at.W, labels, parent)]
    solved = Solved(
        loaded=loaded,
        rows=rows,
        measured=measured,
        camera=camera,
        solution=solution,
        judged=judged or solution,
        cov=cov,
        method=method,
        warnings=warnings,
        inputs=inputs,
        neighbours=neighbours,
        adjustment=told,
    )
    return fill_result(solved)


def _method(
    loaded: CaptureSet,
    rows: np.ndarray,
    solution: Solution,
    measured: Measurements,
    asked: str | None,
) -> tuple[str, list[tuple[str, str]]]:
    """The method to go by, and what to warn of: bare poses cannot be adjusted."""
    if asked not in (None, ADJUSTMENT):
        return asked, []
    problem = why_not(loaded, rows, solution, measured)
    if not problem:
        return ADJUSTMENT, []
    if asked is not None:
        raise error("ARGUMENT_INVALID", f"method {ADJUSTMENT!r}: {problem}; use {ML!r}")
    text = f"{problem}: the uncertainty holds for an exact arm, an exact lens and an exact target only"
    return ML, [(NO_ARM, text)]


def _timed(loaded: CaptureSet) -> bool:
    """Whether poses and images were recorded together, each with its time: then no list was put in order."""
    return all(
        o.t is not None and o.frames and all(f.t is not None for f in o.frames)
        for o in loaded.capture.observations
    )


def given_noise(loaded: CaptureSet) -> dict[str, float]:
    noise = loaded.capture.noise
    return {} if noise is None else {k: float(v) for k, v in noise.model_dump(exclude_none=True).items()}


def measurements(loaded: CaptureSet, rows: np.ndarray) -> Measurements:
    poses = [loaded.poses[k] for k in rows]
    _, group = np.unique(loaded.group[rows], return_inverse=True)
    return Measurements(
        setup=loaded.capture.setup,
        F=loaded.F[rows],
        group=group.astype(np.int64),
        views=[loaded.views[k] for k in rows],
        C=np.stack([np.eye(4) if p is None else p for p in poses]),
        motions=turns(loaded.target.points, loaded.target.symmetries),
    )


def _refused(
    loaded: CaptureSet, refusal: Refusal, warnings: list[tuple[str, str]], inputs: dict[str, Any]
) -> Result:
    unusable = [{"index": loaded.indices[k], "reason": r} for k, r in sorted(loaded.unusable.items())]
    return refused("hand-eye", refusal, warnings, inputs, unobservable=[refusal.words], unusable=unusable)


def _by_classic(solution: Solution, method: str) -> tuple[Solution, np.ndarray | None]:
    """The solution with X by one of OpenCV's solvers and mean target poses, and a jackknife covariance."""
    part = solution.problem.take(solution.used)
    if (count := int(np.bincount(part.group).max())) > _MOST_CLASSIC:
        raise error(
            "ARGUMENT_INVALID",
            f"method {method!r} takes the square of the {count} poses of one placement; use 'ml', or give at "
            f"most {_MOST_CLASSIC}",
        )
    X = solve_classic(part, method)
    if X is None:
        raise error("ARGUMENT_INVALID", f"method {method!r} gives no answer for these data; use 'ml'")
    return _with_pose(solution, X), jackknife(part, method, X)


def _with_pose(solution: Solution, X: np.ndarray) -> Solution:
    """The solution with another X, and the mean target poses that go with it."""
    part = solution.problem.take(solution.used)
    own = part.target_poses(X)
    W = np.stack([se3.mean_pose(own[part.group == g]) for g in range(part.groups)])
    return replace(solution, at=Estimate(X, W))
