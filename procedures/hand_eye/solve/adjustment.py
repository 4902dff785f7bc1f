"""Method ``adjustment``: the solution with arm, gears, lens and target as unknowns beside X."""

from dataclasses import asdict, replace

import numpy as np
from numpy.typing import NDArray

from calibration.adjustment.arm_accuracy import arm_accuracy
from calibration.adjustment.hand_eye import Adjusted, ArmKnown, adjust
from calibration.adjustment.lens_terms import LensPrior
from calibration.hand_eye import se3
from calibration.hand_eye.noise import Noise
from calibration.hand_eye.solution import Measurements, Solution
from calibration.kinematics.families import arm_spec
from cell.errors import error
from cell.formats.robot import parse_robot
from cell.poses import Array
from procedures.hand_eye.solve.camera import CameraChoice
from procedures.hand_eye.solve.capture import CaptureSet
from procedures.hand_eye.solve.result import Adjustment

METHOD = "adjustment"
JOINTS = 6
_NEAR_M, _NEAR_RAD = 0.01, 0.02  # an arm differs from its model by millimetres
# Of intrinsics that were found from the same images: those images are in the adjustment, so nothing else is.
_FROM_IMAGES = LensPrior(focal=0.05, aspect=0.01, centre_px=50.0, radial=0.2, tangential=0.01)


def by_adjustment(
    loaded: CaptureSet,
    rows: NDArray[np.int64],
    measured: Measurements,
    camera: CameraChoice,
    solution: Solution,
) -> tuple[Solution, CameraChoice, Adjustment, list[tuple[str, str]]]:
    """The solution, the camera found, what is told of the unknowns, and what to warn of.

    ``InputError`` where an observation in use is a bare pose: an image alone tells of lens and target.
    """
    bare = [k for k in np.flatnonzero(solution.used).tolist() if measured.views[k] is None]
    if bare or camera.camera is None:
        index = loaded.indices[int(rows[bare[0]])] if bare else loaded.indices[0]
        raise error(
            "ARGUMENT_INVALID",
            f"method {METHOD!r} needs the corners of every observation, and {index} gives a bare "
            "T_camera_target; use 'ml'",
        )
    arm = _arm(loaded, rows, solution)
    lens = LensPrior() if camera.estimated is None else _FROM_IMAGES
    found = adjust(measured, solution, camera.camera, arm, lens)
    warnings = []
    if arm is None:
        why = "no robot" if loaded.capture.robot is None else "no q of every observation"
        text = f"the data set has {why}: the uncertainty holds for an arm without geometric errors only"
        warnings.append(("adjustment.no-arm", text))
    return (
        _solution(solution, found),
        replace(camera, camera=found.camera),
        _told(found, arm),
        warnings,
    )


def _arm(loaded: CaptureSet, rows: NDArray[np.int64], solution: Solution) -> ArmKnown | None:
    """The arm and its joints, where the data set has both."""
    capture = loaded.capture
    joints = [capture.observations[int(row)].q for row in rows]
    used = np.flatnonzero(solution.used)
    if capture.robot is None or any(joints[k] is None for k in used):
        return None
    model = arm_spec(parse_robot(capture.robot, "robot"), "robot").arm
    if model.joints != JOINTS:
        raise error(
            "DATA_INVALID",
            f"{loaded.path}: method {METHOD!r} knows arms of {JOINTS} turning joints, and robot has "
            f"{model.joints}; use 'ml'",
        )
    for k in used:
        if (q := joints[k]) is not None and len(q) != JOINTS:
            raise error(
                "DATA_INVALID",
                f"{loaded.path}: observation {loaded.indices[int(rows[k])]}: q has {len(q)} numbers, and "
                f"robot has {JOINTS} joints",
            )
    Q = np.array([np.zeros(JOINTS) if q is None else q for q in joints], dtype=float)
    _check_flange(loaded, rows[used], model.base.flange(Q[used]))
    return ArmKnown(model, Q, np.tile([-np.pi, np.pi], (JOINTS, 1)))


def _check_flange(loaded: CaptureSet, rows: NDArray[np.int64], flange: Array) -> None:
    """Refuse poses that are not those of the robot's flange at ``q``, with the likely cause."""
    off = se3.inverse(flange) @ loaded.F[rows]
    far = float(np.median(np.linalg.norm(off[:, :3, 3], axis=1)))
    turned = float(np.median(np.linalg.norm(se3.rotation_vectors(off[:, :3, :3]), axis=1)))
    if far < _NEAR_M and turned < _NEAR_RAD:
        return
    mean = se3.mean_pose(off)
    apart = np.linalg.norm((off - mean)[:, :3, 3], axis=1)
    cause = "look at the order of the joints, their unit (rad), and the model of robot"
    if float(np.median(apart)) < 0.1 * far:
        x, y, z = 1e3 * mean[:3, 3]
        cause = f"they carry a tool: a TCP of [{x:.1f}, {y:.1f}, {z:.1f}] mm; give the flange's poses"
    raise error(
        "DATA_INVALID",
        f"{loaded.path}: T_base_flange is not where robot has its flange at q: {1e3 * far:.1f} mm and "
        f"{np.degrees(turned):.1f} deg off (median); {cause}",
    )


def _solution(first: Solution, found: Adjusted) -> Solution:
    """``first`` with its used observations as lens, target and arm were found."""
    problem = first.problem
    G, C, cov, sse = problem.G.copy(), problem.C.copy(), problem.cov_px.copy(), problem.sse.copy()
    for whole, part in (
        (G, found.problem.G),
        (C, found.problem.C),
        (cov, found.problem.cov_px),
        (sse, found.problem.sse),
    ):
        whole[first.used] = part
    return replace(
        first,
        problem=replace(problem, G=G, C=C, cov_px=cov, sse=sse),
        at=type(first.at)(found.X, found.W),
        cov=found.cov,
        cov_W=found.cov_W,
        noise=Noise(dict(found.components.sigma), first.noise.estimated),
        excess=found.excess,
    )


def _told(found: Adjusted, arm: ArmKnown | None) -> Adjustment:
    unknowns: dict[str, dict[str, dict[str, float]]] = {}
    for block, part in found.blocks.items():
        unknowns[block] = {
            name: {"value": float(value), "sigma": float(sigma)}
            for name, value, sigma in zip(
                found.names[part], found.numbers[part], found.sigma[part], strict=True
            )
        }
    return Adjustment(
        unknowns,
        {k: float(v) for k, v in found.components.scale.items()},
        {name: _lengths(part) for name, part in found.budget.items()},
        ("lens", "target") if arm is None else ("arm", "gears", "sag", "lens", "target"),
        None if arm is None else asdict(arm_accuracy(found, arm)),
    )


def _lengths(variances: Array) -> dict[str, float]:
    parts = np.maximum(variances, 0.0)
    return {"t": float(np.sqrt(parts[:3].sum())), "r": float(np.sqrt(parts[3:].sum()))}
