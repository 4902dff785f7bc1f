"""Method ``adjustment``: the solution with arm, gears, lens and target as unknowns beside X."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calibration.adjustment.arm_accuracy import (
    arm_accuracy,
    corrected_arm,
    on_corrected_arm,
    position_accuracy,
    predicted_flange,
)
from calibration.adjustment.hand_eye import Adjusted, adjust, as_found
from calibration.adjustment.jackknife import Checked
from calibration.adjustment.shared_errors import ATTITUDE, PLACE, shared_errors
from calibration.adjustment.task_accuracy import task_accuracy
from calibration.adjustment.unknowns import ArmKnown
from calibration.hand_eye.noise import Noise, reml, weights
from calibration.hand_eye.normal import linearise, minimise
from calibration.hand_eye.problem import Estimate, Problem
from calibration.hand_eye.solution import Measurements, Solution, excess_of
from calibration.kinematics.families import ArmSpec, robot_document
from cell.devices import Intrinsics
from cell.errors import error
from cell.formats.capture import QUERY_SCHEMA, CaptureQuery, Task
from cell.formats.reading import parse, read_json
from cell.poses import Array
from procedures.hand_eye.budget import by_cause
from procedures.hand_eye.known_parts import KnownParts, known_parts, shared_source, without_joints
from procedures.hand_eye.solve.arm import JOINTS, GivenArm
from procedures.hand_eye.solve.camera import CameraChoice
from procedures.hand_eye.solve.capture import CaptureSet
from procedures.hand_eye.solve.result import Adjustment, names, pose6, spreads
from procedures.hand_eye.solve.target_check import target_warnings

METHOD = "adjustment"
LEAVING_OUT = "uncertainty.leaving-out"
NOT_SETTLED = (
    "uncertainty.not-settled",
    "arm, lens or target are so far from what was given that the answer still moved in the last round, and "
    "its uncertainty may be too small: check the intrinsics, the target's size and the arm's kinematics, or "
    "solve again with the lens and the arm that were found",
)
_SIZE_UNKNOWN = 0.02  # of a target whose size was found from the data


@dataclass(frozen=True)
class AdjustedSolution:
    """The solution with the views and the camera that were found, what the result tells of it, and what to
    warn of. ``judged`` has the camera's pose by which its residuals are judged."""

    solution: Solution
    judged: Solution
    measured: Measurements
    camera: CameraChoice
    told: Adjustment
    warnings: Sequence[tuple[str, str]]


def why_not(loaded: CaptureSet, rows: NDArray[np.int64], solution: Solution, measured: Measurements) -> str:
    """Why the data set cannot be adjusted; empty when it can: an image alone tells of lens and target."""
    bare = [k for k in np.flatnonzero(solution.used).tolist() if measured.views[k] is None]
    if not bare:
        return ""
    index = loaded.indices[int(rows[bare[0]])]
    return (
        f"the corners of every observation are needed, and observation {index} gives a bare T_camera_target"
    )


def by_adjustment(
    loaded: CaptureSet,
    rows: NDArray[np.int64],
    measured: Measurements,
    camera: CameraChoice,
    arm_of: tuple[GivenArm | None, str],
    solution: Solution,
    factor: float,
    predict: Path | None,
) -> AdjustedSolution:
    """``solution`` adjusted; ``predict`` is a file of joints whose flange poses are wanted.

    ``arm_of`` is the arm of the observations ``rows``, or why there is none; the target of ``measured`` is
    ``factor`` times as large as the one that was given.
    """
    if camera.camera is None:
        raise ValueError("an adjustment needs the camera of the corners")
    given, without = arm_of
    robot = None if given is None else given.spec
    known = _known(loaded, robot, camera)
    arm = None
    if given is not None:
        limits = np.tile([-np.pi, np.pi], (JOINTS, 1))
        arm = ArmKnown(given.spec.arm, given.Q, limits, known.arm)
    expected = known.target if factor == 1.0 else replace(known.target, scale=_SIZE_UNKNOWN)
    shared = shared_errors(measured.F[solution.used], known.arm) if arm is None else None
    found = adjust(measured, solution, camera.camera, arm or shared, known.lens, expected)
    answer = _answer(found, known, factor) | {"as_configured": spreads(solution)}
    priors = dict(known.sources)
    warnings = target_warnings(found, known.target, factor)
    if shared is not None:
        sizes = shared.sizes(found.components.scale)
        warnings.append(without_joints(without, *sizes))
        priors["arm"] = shared_source(*shared.sizes({}))
        answer["noise"] = _noise(solution, found).as_dict() | {
            "sigma_shared_t": sizes[0],
            "sigma_shared_r": sizes[1],
        }
    elif arm is not None and robot is not None:
        if (task := loaded.capture.task) is not None:
            answer["task"] = _at_task(found, arm, task, loaded.path)
        Q = arm.Q[solution.used] if predict is None else _wanted_joints(predict)
        answer |= _arm_from_board(found, arm, robot, Q)
        if predict is not None:
            T, p_cov = predicted_flange(found, arm, Q)
            answer |= {"T_base_flange": [pose6(one) for one in T], "p_cov": p_cov.tolist()}
    if predict is not None and arm is None:
        raise error("ARGUMENT_INVALID", f"--predict needs robot and q of every observation; {without}")
    covers = ["arm", *(["gears", "sag"] if arm is not None else []), "lens", "target"]
    if found.by_leaving_out.added.any():
        warnings.append((LEAVING_OUT, _leaving_out(found.by_leaving_out)))
    if not found.settled:
        warnings.append(NOT_SETTLED)
    printed, problem = as_found(found, measured, solution)
    adjusted = _solution(solution, problem, found)
    return AdjustedSolution(
        adjusted,
        adjusted if shared is None else _by_poses_alone(solution, problem),
        printed,
        replace(camera, camera=found.camera),
        Adjustment(
            answer,
            {
                "covers": covers,
                "priors": priors,
                "leaving_out": {"ratio": found.by_leaving_out.largest, "limit": found.by_leaving_out.limit},
            },
        ),
        warnings,
    )


def _leaving_out(found: Checked) -> str:
    return (
        f"leaving out single observations moves the camera's pose {found.largest:.1f} times as far as the "
        f"residuals explain (by chance {found.limit:.1f}): the stated uncertainty was enlarged to that; take "
        "more poses of other orientations, and look at the observations with the largest residuals"
    )


def _known(loaded: CaptureSet, robot: ArmSpec | None, camera: CameraChoice) -> KnownParts:
    capture = loaded.capture
    given = None if capture.camera is None else capture.camera.sigma
    return known_parts(
        capture.target.model_dump(),
        None if given is None else given.model_dump(),
        None if robot is None else robot.robot,
        from_images=camera.estimated is not None,
    )


def _at_task(found: Adjusted, arm: ArmKnown, task: Task, path: Path) -> dict[str, float]:
    """``DATA_INVALID`` for joints that the arm does not have."""
    if len(task.q) != JOINTS:
        raise error("DATA_INVALID", f"{path}: task.q has {len(task.q)} joints; the robot has {JOINTS}")
    return asdict(task_accuracy(found, arm, np.array(task.q), task.distance_m))


def _wanted_joints(path: Path) -> Array:
    """(k, 6) of a ``cellward.capture-query/1``."""
    query = parse(CaptureQuery, read_json(path), QUERY_SCHEMA, str(path))
    for k, q in enumerate(query.q):
        if len(q) != JOINTS:
            raise error("DATA_INVALID", f"{path}: q[{k}] has {len(q)} joints; the robot has {JOINTS}")
    return np.array(query.q, dtype=float)


def _noise(first: Solution, found: Adjusted) -> Noise:
    """The noise levels of ``first`` as the adjustment found them."""
    return replace(first.noise, sigma=dict(found.components.sigma))


def _solution(first: Solution, problem: Problem, found: Adjusted) -> Solution:
    """``first`` with what the adjustment found; ``problem`` has every observation as found."""
    return replace(
        first,
        problem=problem,
        at=Estimate(found.X, found.W),
        cov=found.cov,
        cov_W=found.cov_W,
        noise=_noise(first, found),
        excess=found.excess,
    )


def _by_poses_alone(first: Solution, problem: Problem) -> Solution:
    """``first`` with the camera's pose that serves the poses of ``problem`` best, each with its own noise.

    Shared errors are functions of these very poses. Residuals less what was found of them would be those of
    no other pose, so figures by residuals are made without.
    """
    noise, lin = first.noise, linearise(problem.take(first.used), first.at)
    for _ in range(2):  # noise levels and pose in turn
        noise = reml(lin, noise)
        lin = minimise(lin, weights(lin, noise))
    excess = excess_of(lin.r, weights(lin, noise), lin.problem.groups)
    return replace(first, problem=problem, at=lin.at, noise=noise, excess=excess)


def _answer(found: Adjusted, known: KnownParts, factor: float) -> dict[str, object]:
    """What was found of the unknowns, the camera that belongs to X, and the standard uncertainty by cause."""
    sure = {
        name: {"value": float(value), "sigma": float(sigma)}
        for name, value, sigma in zip(found.names, found.numbers, found.sigma, strict=True)
    }
    for axis in ("scale_x", "scale_y"):  # of the target that was given
        value, sigma = sure[axis]["value"], sure[axis]["sigma"]
        sure[axis] = {"value": factor * (1.0 + value) - 1.0, "sigma": factor * sigma}
    x, y = sure["scale_x"], sure["scale_y"]
    return {
        "unknowns": {
            block: {name: sure[name] for name in found.names[part]}
            for block, part in found.blocks.items()
            if block not in (PLACE, ATTITUDE)  # functions of these poses alone
        },
        "scale": {k: float(v) for k, v in found.components.scale.items()},
        "budget": by_cause(found.budget),
        "target_scale": {"x": x["value"], "y": y["value"], "sigma_x": x["sigma"], "sigma_y": y["sigma"]},
        "lens": _camera(found.camera),
        "lens_cov": found.cov_with_lens.tolist(),
    }


def _camera(camera: Intrinsics) -> dict[str, object]:
    return {
        "width": camera.width,
        "height": camera.height,
        "K": list(camera.K),
        "dist": list(camera.dist),
    }


def _arm_from_board(found: Adjusted, arm: ArmKnown, robot: ArmSpec, Q: Array) -> dict[str, object]:
    """The corrected arm as a ROBOT, the camera's pose on it, and the arm's accuracy before and after."""
    corrected, values = corrected_arm(found, arm)
    X, cov = on_corrected_arm(found, arm)
    accuracy = position_accuracy(found, arm, Q)
    name, _, _ = names(found.problem.setup)
    return {
        "arm": asdict(arm_accuracy(found, arm)),
        "robot": robot_document(robot, corrected, values, robot.tools),
        "adjusted": {name: pose6(X), "cov": cov.tolist()},
        "absolute_accuracy": {
            "before": accuracy.before,
            "after": accuracy.after,
            "predicted_95": accuracy.after95,
        },
    }
