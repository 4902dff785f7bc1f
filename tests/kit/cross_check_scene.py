"""A cell that is measured twice, and what changes between: views of a target, and the tool in beams.

The arm is that of :mod:`tests.kit.imperfect_cell`: its links, gears and sag are not as its model, both times.
"""

from dataclasses import dataclass, field

import numpy as np

from calibration.adjustment.arm_by_tracker import SeenArm, seen_arm
from calibration.adjustment.arm_terms import reference_joints
from calibration.adjustment.cross_check import CrossChecked, SeenCamera, SeenTool, cross_check, seen_camera
from calibration.adjustment.hand_eye import adjust
from calibration.adjustment.lens_terms import LensPrior, TargetPrior
from calibration.adjustment.unknowns import ArmKnown
from calibration.hand_eye import se3
from calibration.hand_eye.problem import Setup
from calibration.hand_eye.solution import Measurements, Solution, solve
from calibration.hand_eye.views import CornerSet
from calibration.refusal import Refusal
from cell.poses import Array
from tests.kit.eye_to_hand_scene import POINTS, _project, joints, make_scene, off
from tests.kit.imperfect_cell import CAMERA, FLANGE_R, FLANGE_T, MODEL, PX, World

TOOL_M, CAMERA_M, CAMERA_RAD, JOINT_RAD = 7e-4, 1e-3, 1e-3, 1e-3
TRACKER_M = 2e-5
BEAM_M = 1.5e-5  # noise of the tool's point in the beams, per axis, in each measurement
TIP = np.array([0.0, 0.0, 0.18])
Q_BEAMS = np.array([0.4, -1.4, 1.7, -1.9, -1.5708, 0.3])
_LIMITS = np.tile([-np.pi, np.pi], (6, 1))
_HALF_TURN = np.diag([1.0, -1.0, -1.0, 1.0])
_FEWEST = 12


@dataclass(frozen=True)
class Change:
    """What happens between: the point of the tool moves (m), the camera (4, 4 on its right), zeros (rad)."""

    tool: Array = field(default_factory=lambda: np.zeros(3))
    camera: Array = field(default_factory=lambda: np.eye(4))
    zeros: Array = field(default_factory=lambda: np.zeros(6))


def change(rng: np.random.Generator, part: str, joint: int = 0) -> Change:
    """Of ``part`` (none, tool, camera, joint), in a direction of chance."""
    if part == "tool":
        v = rng.normal(size=3)
        return Change(tool=TOOL_M * v / np.linalg.norm(v))
    if part == "camera":
        return Change(camera=off(rng, CAMERA_M, CAMERA_RAD))
    if part == "joint":
        return Change(zeros=rng.choice([-1.0, 1.0]) * JOINT_RAD * np.eye(6)[joint])
    return Change()


def checked(
    seed: int,
    part: str,
    joint: int = 0,
    setup: Setup = "eye-to-hand",
    poses: int = 40,
    arm_m: float = 2e-4,
    tracker: bool = False,
) -> CrossChecked:
    """The verdict on a cell in which ``part`` has changed, with ``poses`` poses in each capture."""
    rng = np.random.default_rng([seed, 77])
    scene = make_scene(rng, poses, arm_m)
    what = change(rng, part, joint)
    names: list[str] = []
    seen: list[SeenCamera] = []
    for meanwhile in (Change(), what):
        X, W, anew = scene.X, scene.W, off(rng, 0.003, 0.02)  # the target is put anew each time
        X, W = (X, W @ anew) if setup == "eye-to-hand" else (X @ anew, W)
        Q = joints(rng, X, W, poses)
        measured, Q = views(rng, scene.cell, setup, X, W, Q, meanwhile)
        solution = solve(measured, CAMERA, {})
        if isinstance(solution, Refusal):
            raise ValueError(str(solution))
        names, one = _seen(measured, solution, Q, setup)
        seen.append(one)
    then, now = seen
    tool = tool_in_beams(rng, scene.cell, what)
    return cross_check(then, now, tool, names, by_tracker(rng, scene.cell, what) if tracker else None)


def views(
    rng: np.random.Generator, cell: World, setup: Setup, X: Array, W: Array, Q: Array, what: Change
) -> tuple[Measurements, Array]:
    """Corners at joints ``Q`` (n, 6), and those joints; ``X`` and ``W`` are a fixed camera and its target.

    For a camera on the flange the two change places.
    """
    noise = se3.exp(rng.normal(size=(len(Q), 6)) * np.repeat([FLANGE_T, FLANGE_R], 3))
    flange = cell.true_flange(Q + what.zeros) @ noise
    if setup == "eye-to-hand":
        C = se3.inverse(X @ what.camera) @ flange @ W
    else:
        C = se3.inverse(flange @ W @ _HALF_TURN @ what.camera) @ X @ _HALF_TURN
    uv = np.array([_project(T) for T in C])
    inside = np.all((uv > 5.0) & (uv < [CAMERA.width - 6.0, CAMERA.height - 6.0]), axis=(1, 2))
    if inside.sum() < _FEWEST:
        raise ValueError("too few poses show the target")
    uv = (uv + PX * rng.normal(size=uv.shape))[inside]
    n = len(uv)
    own = [CornerSet(POINTS, one, np.ones(len(POINTS))) for one in uv]
    F = MODEL.base.flange(Q)[inside]
    group, none = np.zeros(n, np.int64), np.tile(np.eye(4), (n, 1, 1))
    return Measurements(setup, F, group, list(own), none, np.eye(4)[None]), Q[inside]


def tool_in_beams(rng: np.random.Generator, cell: World, what: Change) -> SeenTool:
    """By how much the tool's point seems to have moved on the flange, both times with noise."""
    then, now = (cell.true_flange((Q_BEAMS + zeros)[None])[0] for zeros in (np.zeros(6), what.zeros))
    R = MODEL.base.flange(Q_BEAMS[None])[0][:3, :3]
    moved = (now[:3, :3] @ (TIP + what.tool) + now[:3, 3]) - (then[:3, :3] @ TIP + then[:3, 3])
    noise = BEAM_M * rng.normal(size=(2, 3))
    J = MODEL.base.jacobians(MODEL.base.frames(Q_BEAMS[None]))[0]
    by_joints = R.T @ (J[:3] + np.cross(J[3:].T, R @ TIP).T)
    return SeenTool(R.T @ moved + noise[1] - noise[0], 2.0 * BEAM_M**2 * np.eye(3), by_joints)


def _seen(measured: Measurements, solution: Solution, Q: Array, setup: Setup) -> tuple[list[str], SeenCamera]:
    arm = ArmKnown(MODEL, Q, _LIMITS)
    found = adjust(measured, solution, CAMERA, arm, LensPrior(), TargetPrior(scale=1e-4, bow=2e-5))
    return list(found.names), seen_camera(found, arm, setup)


def in_tracker(rng: np.random.Generator, cell: World, what: Change, count: int = 60) -> tuple[Array, Array]:
    """Joints (n, 6), and places (n, 3) m of a reflector in a tracker that stands anywhere."""
    Q = reference_joints(_LIMITS, 10)[rng.permutation(1024)[:count]]
    p = cell.true_flange(Q + what.zeros) @ [0.04, -0.05, 0.09, 1.0]
    place = off(rng, 3.0, 1.0)
    return Q, (p @ place.T)[:, :3] + TRACKER_M * rng.normal(size=(count, 3))


def by_tracker(rng: np.random.Generator, cell: World, what: Change) -> SeenArm:
    """What they tell of the arm."""
    Q, places = in_tracker(rng, cell, what)
    sigma = np.full(len(Q), np.hypot(TRACKER_M, FLANGE_T))
    return seen_arm(ArmKnown(MODEL, Q, _LIMITS), places, np.zeros(len(Q), np.int64), sigma)
