"""A cell that is measured twice, and what changes between: views of a target, and the tool in beams or over a
board.

The arm is that of :mod:`tests.kit.imperfect_cell`: its links, gears and sag are not as its model, both times.
Nor is the lens, which differs a little from then to now, as temperature makes it.
"""

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from calibration.adjustment.arm_by_tracker import SeenArm, seen_arm
from calibration.adjustment.arm_terms import reference_joints
from calibration.adjustment.cross_check import (
    LENS_STILL,
    CrossChecked,
    SeenCamera,
    SeenTool,
    cross_check,
    seen_camera,
)
from calibration.adjustment.hand_eye import Adjusted, adjust
from calibration.adjustment.lens_terms import LENS, LensPrior, TargetPrior, moved_camera
from calibration.adjustment.touch import Touches, seen_touch
from calibration.adjustment.unknowns import ArmKnown
from calibration.hand_eye import se3
from calibration.hand_eye.problem import Setup
from calibration.hand_eye.solution import Measurements, Solution, solve
from calibration.hand_eye.views import CornerSet
from calibration.refusal import Refusal
from calibration.touch import outermost
from cell.devices import Intrinsics
from cell.poses import Array
from tests.kit.eye_to_hand_scene import POINTS, joints, make_scene, off, project
from tests.kit.imperfect_cell import ARM, CAMERA, FLANGE_R, FLANGE_T, MODEL, PX, World

TOOL_M, CAMERA_M, CAMERA_RAD, JOINT_RAD = 7e-4, 1e-3, 1e-3, 1e-3
TRACKER_M = 2e-5
BEAM_M = 1.5e-5  # noise of the tool's point in the beams, per axis, in each measurement
TIP = np.array([0.0, 0.0, 0.18])
Q_BEAMS = np.array([0.4, -1.4, 1.7, -1.9, -1.5708, 0.3])
_LIMITS = np.tile([-np.pi, np.pi], (6, 1))
HALF_TURN = np.diag([1.0, -1.0, -1.0, 1.0])
_FEWEST = 12
# A board on the table, its z into the table, and the camera half a metre above it.
_BOARD = RigidTransform.from_components([0.7, 0.2, 0.1], Rotation.from_euler("xz", [np.pi, 0.6]))
_LOOK = RigidTransform.from_components([0.0, 0.0, 0.5], Rotation.from_rotvec([0.15, -0.1, 0.0]))
STAND_OFF_M, STAND_M, REFERENCE_M = 0.003, 1e-4, 5e-5


@dataclass(frozen=True)
class Change:
    """What happens between: the point of the tool moves (m), the camera (4, 4 on its right), zeros (rad)."""

    tool: Array = field(default_factory=lambda: np.zeros(3))
    camera: Array = field(default_factory=lambda: np.eye(4))
    zeros: Array = field(default_factory=lambda: np.zeros(6))


def change(rng: np.random.Generator, part: str, joint: int = 0, tool_m: float = TOOL_M) -> Change:
    """Of ``part`` (none, tool, camera, joint), in a direction of chance."""
    if part == "tool":
        v = rng.normal(size=3)
        return Change(tool=tool_m * v / np.linalg.norm(v))
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
    beams: bool = True,
    touch: bool = False,
    tool_m: float = TOOL_M,
) -> CrossChecked:
    """The verdict on a cell in which ``part`` has changed, with ``poses`` poses in each capture."""
    rng = np.random.default_rng([seed, 77])
    scene = make_scene(rng, poses, arm_m)
    what = change(rng, part, joint, tool_m)
    seen: list[SeenCamera] = []
    for meanwhile, lens in zip((Change(), what), lenses(seed), strict=True):
        X, W, anew = scene.X, scene.W, off(rng, 0.003, 0.02)  # the target is put anew each time
        X, W = (X, W @ anew) if setup == "eye-to-hand" else (X @ anew, W)
        Q = joints(rng, X, W, poses)
        measured, Q = views(rng, scene.cell, setup, X, W, Q, meanwhile, lens)
        solution = solve(measured, CAMERA, {})
        if isinstance(solution, Refusal):
            raise ValueError(str(solution))
        found, arm = _adjusted(measured, solution, Q)
        seen.append(seen_camera(found, arm, LensPrior()))
    then, now = seen
    tool = tool_in_beams(rng, scene.cell, what) if beams else None
    by_arm = by_tracker(rng, scene.cell, what) if tracker else None
    by_touch = None
    if touch:
        of = touched(rng, scene.cell, scene.W @ HALF_TURN, what, lens)
        by_touch = seen_touch(of, found, arm, PX)
    return cross_check(then, now, tool, found.names, by_arm, by_touch)


def lenses(seed: int) -> tuple[Intrinsics, Intrinsics]:
    """The lens then and now, as far off the one that is given as a maker's calibration leaves it."""
    rng = np.random.default_rng([seed, 78])
    then = LensPrior().sigma() * rng.normal(size=len(LENS))
    now = then + LENS_STILL.sigma() * rng.normal(size=len(LENS))
    return moved_camera(CAMERA, then), moved_camera(CAMERA, now)


def views(
    rng: np.random.Generator,
    cell: World,
    setup: Setup,
    X: Array,
    W: Array,
    Q: Array,
    what: Change,
    lens: Intrinsics = CAMERA,
) -> tuple[Measurements, Array]:
    """Corners at joints ``Q`` (n, 6), and those joints; ``X`` and ``W`` are a fixed camera and its target.

    For a camera on the flange the two change places.
    """
    noise = se3.exp(rng.normal(size=(len(Q), 6)) * np.repeat([FLANGE_T, FLANGE_R], 3))
    flange = cell.true_flange(Q + what.zeros) @ noise
    if setup == "eye-to-hand":
        C = se3.inverse(X @ what.camera) @ flange @ W
    else:
        C = se3.inverse(flange @ W @ HALF_TURN @ what.camera) @ X @ HALF_TURN
    uv = np.array([project(T, lens) for T in C])
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


def _adjusted(measured: Measurements, solution: Solution, Q: Array) -> tuple[Adjusted, ArmKnown]:
    arm = ArmKnown(MODEL, Q, _LIMITS)
    return adjust(measured, solution, CAMERA, arm, LensPrior(), TargetPrior(scale=1e-4, bow=2e-5)), arm


def touched(
    rng: np.random.Generator, cell: World, camera: Array, what: Change, lens: Intrinsics = CAMERA
) -> Touches:
    """The tool's point over the outermost corners of a board, as a person has brought it there; ``camera``
    (4, 4) is T_flange_camera of then."""
    board, on_flange = _BOARD.as_matrix(), camera @ what.camera
    looking = _BOARD * (_LOOK * RigidTransform.from_translation(-POINTS.mean(axis=0))).inv()
    q_look = ARM.inverse_all(looking * RigidTransform.from_matrix(camera).inv())[0]
    true = cell.true_flange((q_look + what.zeros)[None])[0]
    uv = project(se3.inverse(true @ on_flange) @ board, lens)
    view = CornerSet(POINTS, uv + PX * rng.normal(size=uv.shape), np.ones(len(POINTS)))
    points = POINTS[outermost(POINTS)]
    down = RigidTransform.from_rotation(_BOARD.rotation)
    joints_there = []
    for place in _BOARD.apply(points - [0.0, 0.0, STAND_OFF_M]):
        wanted = place + STAND_M * rng.normal(size=3)
        goal = RigidTransform.from_translation(place) * down * RigidTransform.from_translation(-TIP)
        for _ in range(4):
            q = ARM.inverse_all(goal)[0]
            there = cell.true_flange((q + what.zeros)[None])[0]
            off_by = there[:3, :3] @ (TIP + what.tool) + there[:3, 3] - wanted
            goal = RigidTransform.from_translation(-off_by) * goal
        joints_there.append(q)
    Q = np.array(joints_there)
    return Touches(q_look, Q, view, points, STAND_OFF_M, TIP, REFERENCE_M, STAND_M, FLANGE_T)


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
