"""Planning for the worker process: joints over each corner, and every way checked; nothing here moves."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from calibration.touch import outermost, over_points, towards_camera
from cell.errors import CellError, error, present
from cell.guard import MotionGuard
from cell.poses import Array, from_pose6, to_pose6
from cell.run_values import RunValues
from procedures.arm_setup import lease_settings
from procedures.hand_eye_in_use import require_hand_eye
from procedures.touch_test.config import TouchTestConfig
from procedures.touch_test.data import LookTaken, located, printed_points

MOTION_ERRORS = ("MOTION_LIMIT", "MOTION_COLLISION", "MOTION_UNREACHABLE")
_SPINS = 12  # of the tool about its axis, of which the one that turns the joints least is taken


@dataclass(frozen=True)
class CornerPlan:
    """The flange above a corner and over it, (6,) m and rad; ``q_above`` are the joints above it, rad."""

    corner: int
    q_above: list[float]
    T_above: list[float]
    T_over: list[float]


@dataclass(frozen=True)
class TouchPlan:
    """The corners in order; ``away`` (3,) m in the base is the way up from the board."""

    corners: list[CornerPlan]
    away: list[float]
    listing: dict[str, Any]


def plan_touch(values: RunValues, config: TouchTestConfig, look: LookTaken, q_now: list[float]) -> TouchPlan:
    """Of the board as it is seen. The tool's z points into the board; of the turns about it the first one is
    taken that the guard allows. ``BOARD_NOT_SEEN`` for corners that the look does not show, else
    ``MOTION_LIMIT``, ``MOTION_COLLISION`` or ``MOTION_UNREACHABLE`` of the turn that is nearest."""
    guard = lease_settings(values)[0]
    printed = printed_points(dict(values.targets[config.target]), look)
    C = located(look, printed).C[0]
    camera = from_pose6(look.T_base_flange) * require_hand_eye(values)
    T_base_target = camera * RigidTransform.from_matrix(C)
    ids = _corners(config, look, printed)
    points = printed[ids]
    up = T_base_target.rotation.apply([0.0, 0.0, towards_camera(C)])
    ways = [
        T_base_target.apply(over_points(points, C, height)) for height in (config.clear_m, config.stand_off_m)
    ]
    refusal: CellError | None = None
    for attitude in _attitudes(values, guard, -up, np.array(look.q)):
        try:
            stations = _stations(values, guard, attitude, ways, np.array(look.q))
            _check(guard, config, stations, np.array(q_now))
        except CellError as exc:
            if exc.name not in MOTION_ERRORS:
                raise
            refusal = refusal or exc
            continue
        corners = [
            CornerPlan(corner, q.tolist(), to_pose6(above).tolist(), to_pose6(over).tolist())
            for corner, (q, above, over) in zip(ids, stations, strict=True)
        ]
        return TouchPlan(corners, (config.clear_m * up).tolist(), _listing(guard, config, corners))
    raise present(refusal, "refusal of the guard")


def _corners(config: TouchTestConfig, look: LookTaken, points: Array) -> list[int]:
    if config.corners is None:
        return [look.ids[k] for k in outermost(points[look.ids])]
    if missing := sorted(set(config.corners) - set(look.ids)):
        raise error("BOARD_NOT_SEEN", f"the look does not show corner {missing[0]} of '{config.target}'")
    return config.corners


def _attitudes(values: RunValues, guard: MotionGuard, into: Array, q: Array) -> list[Rotation]:
    """Of the tool with its z along ``into`` (3,), the one that is nearest to that at joints ``q`` first."""
    tool = from_pose6(values.tool["T_flange_tool"]).rotation
    now = guard.model.forward(q).rotation * tool
    z = now.apply([0.0, 0.0, 1.0])
    axis, cosine = np.cross(z, into), float(z @ into)
    sine = float(np.linalg.norm(axis))
    if sine < 1e-9:  # along it, or against it: any axis across will do
        axis, sine = now.apply([1.0, 0.0, 0.0]), 1.0 if cosine < 0.0 else 0.0
        turned = Rotation.from_rotvec(np.pi * sine * axis) * now
    else:
        turned = Rotation.from_rotvec(np.arctan2(sine, cosine) / sine * axis) * now
    spins = sorted(range(_SPINS), key=lambda k: min(k, _SPINS - k))
    return [Rotation.from_rotvec(2.0 * np.pi * k / _SPINS * into) * turned for k in spins]


def _stations(
    values: RunValues, guard: MotionGuard, attitude: Rotation, ways: list[Array], near: Array
) -> list[tuple[Array, RigidTransform, RigidTransform]]:
    """Joints above each corner, and the flange above and over it."""
    tool = from_pose6(values.tool["T_flange_tool"]).inv()
    found = []
    for above, over in zip(*ways, strict=True):
        T_above, T_over = (RigidTransform.from_components(p, attitude) * tool for p in (above, over))
        q = guard.model.inverse(T_above, near)
        if q is None:
            x, y, z = above
            raise error("MOTION_UNREACHABLE", f"the tool's point cannot be at {x:.3f}, {y:.3f}, {z:.3f} m")
        found.append((q, T_above, T_over))
        near = q
    return found


def _check(
    guard: MotionGuard,
    config: TouchTestConfig,
    stations: list[tuple[Array, RigidTransform, RigidTransform]],
    q_now: Array,
) -> None:
    """Every way of the job: to the first corner, down to each and up again, and across to the next."""
    guard.check_path_joints(q_now, stations[0][0])
    for k, (q, above, over) in enumerate(stations):
        guard.check_path_linear(above, over, q, config.speed_m_s)
        if k:
            before, T_before, _ = stations[k - 1]
            guard.check_path_linear(T_before, above, before)


def _listing(guard: MotionGuard, config: TouchTestConfig, corners: list[CornerPlan]) -> dict[str, Any]:
    return {
        "kind": "touch-test",
        "stand_off_m": config.stand_off_m,
        "clear_m": config.clear_m,
        "poses": [
            {
                "index": f"corner {c.corner}",
                "q": c.q_above,
                "T_base_flange": c.T_over,
                "checks": guard.describe(np.array(c.q_above)).as_dict(),
            }
            for c in corners
        ],
    }
