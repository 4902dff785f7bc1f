"""Simulated captures of a UR10e, its lens and its board that are not as their models.

The true arm has deviations of its chain, errors of its gears and sag; the controller reports the flange of
the nominal arm. The true X is the one that serves best with the nominal arm over all its joints.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property

import cv2
import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from calibration.adjustment.arm_terms import reference_joints
from calibration.adjustment.gauge import base_and_flange
from calibration.hand_eye import se3
from calibration.hand_eye.solution import Measurements
from calibration.hand_eye.views import CornerSet
from calibration.kinematics.chain import SerialChain
from calibration.kinematics.families import arm_spec
from calibration.kinematics.ur import UrArmModel
from cell.devices import Intrinsics
from cell.formats.robot import parse_robot
from cell.poses import Array

CAMERA = Intrinsics(2560, 1600, (1800.0, 1800.0, 1280.0, 800.0), (0.0, 0.0, 0.0, 0.0, 0.0))
POINTS = np.array([[0.025 * x, 0.025 * y, 0.0] for y in range(1, 7) for x in range(1, 10)])
X_NOMINAL = RigidTransform.from_components([0.02, -0.08, 0.05], Rotation.from_rotvec([0.1, -0.2, 0.3]))
ARM = UrArmModel("ur10e")
MODEL = arm_spec(parse_robot({"model": "ur10e"}, "robot"), "robot").arm
PX, FLANGE_T, FLANGE_R = 0.2, 3e-5, 5e-5
ANGLE_PER_M = 1.5  # of an arm: standard deviation of its angles (rad) for one of its lengths (m)
PLANS = {
    "cone": (3, 20),
    "few on cones": (3, 10),
    "one cone": (1, 12),
    "diverse": (10, 20),
    "branches": (3, 40),
    "few branches": (3, 20),
    "small": (1, 24),
    "few": (1, 12),
    "long": (3, 66),
}  # placements, poses
_CONES, _BRANCHES = ("cone", "few on cones", "one cone"), ("branches", "few branches", "long")
_JOINTS = 13  # as a power of two: all over what the arm can reach
SCALES = {"scale": 5e-4, "slight": 1e-4}
WHOLE_PLANS = ("cone", "diverse", "branches")

Seen = tuple[Array, Array, CornerSet]
"""One pose: the flange (4, 4) as the controller has it, joints (6,), and the view of the board."""


@dataclass(frozen=True)
class World:
    """One cell: its true arm (numbers of its links, joint errors), camera and board points.

    The true flange is about ``base @ nominal @ flange``: (4, 4) that serve best over 2 ** ``joints`` joints.
    """

    links: Array
    gear: Array
    camera: Intrinsics
    points: Array
    joints: int = _JOINTS

    @cached_property
    def chain(self) -> SerialChain:
        return MODEL.chain(self.links)

    @property
    def base(self) -> Array:
        return self._serving[0]

    @property
    def flange(self) -> Array:
        return self._serving[1]

    @cached_property
    def _serving(self) -> tuple[Array, Array]:
        """Base and flange (4, 4) with which the nominal arm is nearest to the true one."""
        Q, nominal = _everywhere(self.joints)
        return base_and_flange(nominal, self.true_flange(Q))

    @property
    def X(self) -> Array:
        """The camera on the flange, for the nominal arm."""
        return np.asarray(self.flange @ X_NOMINAL.as_matrix())

    def true_flange(self, Q: Array) -> Array:
        """(n, 4, 4) at joints (n, 6)."""
        return self.chain.flange(Q + _joint_error(Q, self.gear))


@cache
def _everywhere(power: int) -> tuple[Array, Array]:
    """Joints (2 ** power, 6) all over what the arm can reach, and the nominal flange (n, 4, 4) there."""
    Q = reference_joints(ARM.joint_limits, power, seed=77)
    return Q, MODEL.base.flange(Q)


def _joint_error(Q: Array, gear: Array) -> Array:
    waves = np.stack([np.sin(Q), np.cos(Q), np.sin(2 * Q), np.cos(2 * Q)], axis=-1)
    error = np.sum(waves * gear[:24].reshape(6, 4), axis=-1)
    error[:, 1] += gear[24] * np.cos(Q[:, 1]) + gear[25] * np.cos(Q[:, 1] + Q[:, 2])
    error[:, 2] += gear[26] * np.cos(Q[:, 1] + Q[:, 2])
    return np.asarray(error)


def world(
    rng: np.random.Generator,
    arm_m: float,
    lens: str,
    board: str,
    gear_rad: float = 2e-5,
    sag_rad: float = 1e-4,
    joints: int = _JOINTS,
) -> World:
    """``arm_m``: standard deviation of a length; angles have ``ANGLE_PER_M`` times that, gears and sag their
    own.

    ``lens``: exact, or off by 0.3 % and 3 px. ``board``: exact, its scale off by 0.05 %, a bow of 0.2 mm, or
    slight: 0.01 % and that bow. ``joints``: 2 ** 11 show base and flange to 5 um and 7 urad in a quarter of
    the time.
    """
    kinds = np.array(MODEL.kinds)
    sigma = np.where(kinds == "length", arm_m, ANGLE_PER_M * arm_m)
    links = MODEL.nominal + rng.normal(size=len(sigma)) * sigma
    gear = rng.normal(size=27) * np.array([gear_rad] * 24 + [sag_rad] * 3) * (arm_m > 0.0)
    camera = CAMERA
    if lens == "off":
        f, _, cx, cy = CAMERA.K
        f *= 1.0 + rng.choice([-1.0, 1.0]) * 3e-3
        camera = replace(CAMERA, K=(f, f, cx + 3 * rng.normal(), cy + 3 * rng.normal()))
    points = POINTS.copy()
    if board in SCALES:
        points *= 1.0 + rng.choice([-1.0, 1.0]) * SCALES[board]
    if board in ("bow", "slight"):
        off = (POINTS - POINTS.mean(axis=0))[:, :2]
        turn = rng.uniform(0, np.pi)
        across = off @ (np.cos(turn), np.sin(turn))
        points[:, 2] += rng.choice([-1.0, 1.0]) * 2e-4 * (across / np.abs(across).max()) ** 2
    return World(links, gear, camera, points, joints)


def capture(rng: np.random.Generator, cell: World, plan: str) -> tuple[Measurements, Array]:
    """Views and joints; the flange as the controller has it, from the nominal arm."""
    places, each = PLANS[plan]
    placements = []
    for _ in range(places):
        own: list[Seen] = []
        while len(own) < each:  # a place where some pose is out of reach is another one
            own = _placement(rng, cell, plan, each)
        placements.append(own)
    return gathered(placements)


def gathered(placements: Sequence[Sequence[Seen]]) -> tuple[Measurements, Array]:
    """One capture of all placements, and its joints (n, 6)."""
    every = [seen for own in placements for seen in own]
    group = np.repeat(np.arange(len(placements)), [len(own) for own in placements])
    none = np.tile(np.eye(4), (len(every), 1, 1))
    F, Q = np.array([f for f, _, _ in every]), np.array([q for _, q, _ in every])
    return Measurements("eye-in-hand", F, group, [v for _, _, v in every], none, np.eye(4)[None]), Q


def capture_eye_to_hand(
    rng: np.random.Generator, cell: World, plan: str = "cone"
) -> tuple[Measurements, Array, Array]:
    """The first cone of ``plan`` with camera and board changed over: the camera stands in the base where the
    board was.

    Views, joints, and the true T_base_camera (4, 4) for the nominal arm.
    """
    measured, Q = capture(rng, cell, plan)
    rows = np.flatnonzero(measured.group == 0)
    first = measured.views[rows[0]]
    if first is None or first.start is None:
        raise ValueError("the capture has no start poses")
    centre = RigidTransform.from_translation(POINTS.mean(axis=0)).as_matrix()
    camera = measured.F[rows[0]] @ X_NOMINAL.as_matrix() @ first.start @ centre
    views: list[CornerSet | None] = []
    for i in rows:
        off = se3.exp(rng.normal(size=6) * np.array([FLANGE_T] * 3 + [FLANGE_R] * 3))
        on_flange = X_NOMINAL.as_matrix() @ se3.inverse(centre)
        C = se3.inverse(camera) @ cell.true_flange(Q[i : i + 1])[0] @ off @ on_flange
        views.append(_view(rng, cell, C, C))
    F, none = measured.F[rows], np.tile(np.eye(4), (len(rows), 1, 1))
    group = np.zeros(len(rows), dtype=np.int64)
    captured = Measurements("eye-to-hand", F, group, views, none, np.eye(4)[None])
    return captured, Q[rows], se3.inverse(cell.base) @ camera


def _view(rng: np.random.Generator, cell: World, C: Array, start: Array) -> CornerSet:
    uv, _ = cv2.projectPoints(
        cell.points, cv2.Rodrigues(C[:3, :3])[0], C[:3, 3], cell.camera.matrix, np.array(cell.camera.dist)
    )
    uv = uv.reshape(-1, 2) + rng.normal(size=(len(POINTS), 2)) * PX
    return CornerSet(POINTS, uv, np.ones(len(POINTS)), start)


def board_somewhere(rng: np.random.Generator) -> tuple[RigidTransform, float]:
    """T_base_target within the arm's reach, and the direction (rad) in which it lies."""
    a, reach = rng.uniform(-np.pi, np.pi), rng.uniform(0.5, 0.8)
    W = RigidTransform.from_components(
        [reach * np.cos(a), reach * np.sin(a), rng.uniform(-0.3, 0.2)],
        Rotation.from_rotvec(rng.normal(size=3) * 0.2),
    )
    return W, a


def seen_from(rng: np.random.Generator, cell: World, q: Array, W: RigidTransform, start: Array) -> Seen:
    """The board at ``W``, with joints ``q`` (6,); ``start`` (4, 4) is about where the camera sees it."""
    noise = rng.normal(size=6) * np.array([FLANGE_T] * 3 + [FLANGE_R] * 3)
    true = cell.true_flange(q[None])[0] @ se3.exp(noise)
    T = se3.inverse(true @ X_NOMINAL.as_matrix()) @ W.as_matrix()
    return MODEL.base.flange(q[None])[0], q, _view(rng, cell, T, start)


def _placement(rng: np.random.Generator, cell: World, plan: str, each: int) -> list[Seen]:
    """Each pose about a board somewhere; fewer where one is out of reach."""
    W, a = board_somewhere(rng)
    down = Rotation.from_rotvec([np.pi, 0.0, 0.0])
    out = []
    for k in range(each):
        cone = plan in _CONES
        wide = 0.44 if cone else rng.uniform(0.0, 0.7)
        f = 2 * np.pi * k / each if cone else rng.uniform(0, 2 * np.pi)
        about = 0.3 * rng.normal() if cone else rng.uniform(-3.0, 3.0)
        R = Rotation.from_rotvec([wide * np.sin(f), -wide * np.cos(f), 0.0])
        R = Rotation.from_rotvec([0.0, 0.0, about]) * R * down
        C = RigidTransform.from_components([0, 0, (0.40, 0.60)[k % 2]] - R.apply(POINTS.mean(axis=0)), R)
        found = ARM.inverse_all(W * C.inv() * X_NOMINAL.inv())
        if not found:
            break
        order = sorted(found, key=lambda q: (q[4] < 0, q[2] < 0, abs(q[0] - a)))
        q = order[rng.integers(len(order))] if plan in _BRANCHES else order[0]
        out.append(seen_from(rng, cell, q, W, C.as_matrix()))
    return out
