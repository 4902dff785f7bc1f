"""The motion guard: what every move and every set-point has to pass before it is sent.

A supervisor's plausibility check against the configured boxes, not a safety function: it knows only what
``cell.toml`` says, and the links are approximate capsules.
"""

from collections.abc import Callable
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from cell.arm_model import ArmModel
from cell.errors import CellError, error
from cell.guard._body import Body
from cell.guard._margins import PoseMargins, margins_of
from cell.guard._rules import Finding, Rules
from cell.guard.limits import GuardLimits, Tool
from cell.joint_limits import JOINTS
from cell.poses import Array

SAMPLE_M = 0.01  # no point of the arm moves farther between two samples of a path
PLANNED_CLEAR_M = SAMPLE_M  # twice what a path can come nearer to anything between two samples
_STRIDE = 5  # samples of a path of which one is looked at first
_SAFELY = 1.05  # times what the arm moves: far more than rounding
_JUMP_RAD = 0.5  # a joint that turns this far within one sample of a line has changed its branch
_SMOOTH_RAD = 0.1  # no joint turns farther within one sample of a line unless branches are close
_TOGETHER = 8  # samples of a line, so near each other that their joints are found from common starts
_MEASURED_M = 0.0005  # a path starts at *measured* joints: what was planned onto a face may leave it again
_NOISE_RAD = 1e-3  # joints that turn by less get up to no speed, and noise of a pose is a tenth of it
_TURN_SHARE = 0.5  # the tool turns on a line at this share of the joints' limit: it takes several joints
_WRONG_ARM_M = 0.01  # the published model of a UR is within 3 mm of its factory calibration


Place = Callable[[int], str]  # a sample of what is checked, in words


class MotionGuard:
    """Checks joints, paths and set-points of one arm with one tool; every failure is a coded error.

    ``MOTION_LIMIT`` for joint ranges and speeds, ``MOTION_COLLISION`` for boxes, floor and self-contact,
    ``MOTION_UNREACHABLE`` for poses without joints. Boxes are exact at each sample and to 5 mm between.
    """

    def __init__(self, model: ArmModel, limits: GuardLimits, tool: Tool) -> None:
        self.model, self.limits, self.tool = model, limits, tool
        self._body = Body(model, tool)
        self._rules = Rules(self._body, limits)
        self._joint_limits = model.joint_limits

    def check_joints(self, q: Array) -> None:
        """Joint ranges and geometry at ``q`` (6,) rad."""
        self._check(_six(q)[None], lambda _: "at this pose", np.zeros(1))

    def check_standing(self, q: Array) -> None:
        """As :meth:`check_joints` for measured ``q`` (6,) rad, with the room that the start of a path has."""
        self._check(_six(q)[None], lambda _: "where the arm stands", np.full(1, -_MEASURED_M))

    def free(self, Q: Array, clear_m: float = 0.0) -> NDArray[np.bool_]:
        """(n,): which of ``Q`` (n, 6) rad :meth:`check_joints` would let pass, for planning with many.

        ``clear_m`` is what they keep of every box and of the arm itself beyond that.
        """
        low, high = self._joint_limits.T
        within: NDArray[np.bool_] = np.all((low - 1e-9 <= Q) & (high + 1e-9 >= Q), axis=1)
        return within & self._rules.kept(self._body.ends(Q), clear_m)

    def check_path_joints(self, q0: Array, q1: Array, clear_m: float = 0.0) -> None:
        """The straight joint path from ``q0`` to ``q1`` (6,) rad, ends included.

        A plan keeps ``clear_m`` (:data:`PLANNED_CLEAR_M`) all the way, or as much as the nearer end has: what
        lies between two samples then cannot be beyond a limit, and an arm stopped there can leave again.
        """
        start, end = _six(q0), _six(q1)
        samples = self._joint_samples(start, end)
        place, limit = _on_path(len(samples)), _path_limit(len(samples))
        self._check_joint_range(samples, place)
        rows = self._doubtful(samples, limit, clear_m)
        if len(rows):
            finding = self._rules.first_broken(self._body.ends(samples[rows]), limit[rows], clear_m)
            if finding is not None:
                raise _collision(finding, place(int(rows[finding.index])))

    def check_path_linear(
        self, T0: RigidTransform, T1: RigidTransform, q0: Array, speed_m_s: float | None = None
    ) -> None:
        """The TCP's straight line between two flange poses, from the joints ``q0`` (6,) rad.

        Joint speeds are judged at ``speed_m_s``, or at the configured line speed.
        """
        start = _six(q0)
        away = float(np.linalg.norm(self.model.forward(start).translation - T0.translation))
        if away > _WRONG_ARM_M:
            raise error(
                "MOTION_LIMIT",
                f"the model '{self.model.name}' puts the flange {1e3 * away:.1f} mm from where the "
                "controller reports it; check [robot] model and its calibration",
            )
        Q, step_s = self._follow_line(T0, T1, start, speed_m_s or self.limits.speed_m_s)
        fine = [self._joint_samples(a, b)[1:] for a, b in pairwise(Q)]
        samples = np.concatenate([Q[:1], *fine])
        self._check(samples, _on_path(len(samples)), _path_limit(len(samples)))
        self._check_line_speed(Q, step_s, speed_m_s or self.limits.speed_m_s)

    def check_setpoints(self, Q: Array, Qd: Array) -> None:
        """Set-points of a stream: geometry at ``Q`` (n, 6) rad, speeds of joints and TCP at ``Qd`` (n, 6)."""
        joints, speeds = _sixes(Q), _sixes(Qd)
        flange = self._body.flange(joints)
        slack = np.full(len(Q), -_MEASURED_M)
        self._check(joints, lambda _: "at this set-point", slack, flange=flange)
        limits = self.limits.joint_speeds_rad_s
        n, worst = np.unravel_index(int(np.argmax(np.abs(speeds) / limits)), speeds.shape)
        if abs(speeds[n, worst]) > limits[worst] * (1.0 + 1e-9):
            raise error(
                "MOTION_LIMIT",
                f"set-point turns joint '{JOINTS[worst]}' at {abs(speeds[n, worst]):.3f} rad/s, "
                f"limit {limits[worst]:g} rad/s",
            )
        levers = flange[:, :3, :3] @ self.tool.T_flange_tool.translation
        twists = np.einsum("nij,nj->ni", self.model.jacobian_many(joints), speeds)
        (wx, wy, wz), (x, y, z) = twists[:, 3:].T, levers.T
        turning = np.stack([wy * z - wz * y, wz * x - wx * z, wx * y - wy * x], axis=1)
        tcp = float(np.linalg.norm(twists[:, :3] + turning, axis=1).max())
        if tcp > self.limits.speed_m_s * (1.0 + 1e-9):
            raise error(
                "MOTION_LIMIT",
                f"set-point moves the TCP at {tcp:.3f} m/s, limit {self.limits.speed_m_s:g} m/s",
            )

    def describe(self, q: Array) -> PoseMargins:
        """How far ``q`` (6,) rad is from each limit; broken ones are negative, nothing is raised."""
        joints = _six(q)
        return margins_of(joints, self.model, self._rules, self._body.ends(joints[None]), JOINTS)

    @property
    def radii(self) -> Array:
        """(m,) m: the radii of the capsules that stand for links and tool."""
        return self._body.radii

    def capsule_ends(self, Q: Array) -> Array:
        """(n, m, 2, 3) m: both ends of every capsule in the base, for joints ``Q`` (n, 6)."""
        return self._body.ends(Q)

    def _check(
        self,
        Q: Array,
        place: Place,
        slack_limit: Array,
        clear_m: float = 0.0,
        flange: Array | None = None,
    ) -> None:
        self._check_joint_range(Q, place)
        finding = self._rules.first_broken(self._body.ends(Q, flange), slack_limit, clear_m)
        if finding is not None:
            raise _collision(finding, place(finding.index))

    def _doubtful(self, samples: Array, limit: Array, clear_m: float) -> NDArray[np.intp]:
        """(k,) which of the ``samples`` (n, 6) of a path can be the first to break a rule, with both ends;
        none of them where the path is free.

        One sample in ``_STRIDE`` is looked at. On the way to the next one nothing comes nearer to anything by
        more than it moves: where two of them have enough to spare, those between them break no rule.
        """
        last = len(samples) - 1
        if last < 2 * _STRIDE:
            return np.arange(last + 1)
        seen = np.append(np.arange(0, last, _STRIDE), last)
        turned = np.abs(samples[-1] - samples[0]) / last * self._body.reach_after
        spare = self._rules.spare(self._body.ends(samples[seen]), limit[seen], clear_m, turned)
        broken = np.flatnonzero(spare < 0.0)
        until = int(broken[0]) if len(broken) else len(seen)
        doubt = spare[:-1] + spare[1:] < _SAFELY * np.diff(seen)
        doubt[until:] = False
        if not doubt.any() and not len(broken):
            return seen[:0]
        rows = np.zeros(last + 1, dtype=bool)
        rows[[0, last]] = True
        for k in np.flatnonzero(doubt):
            rows[seen[k] : seen[k + 1] + 1] = True
        rows[seen[broken[:1]]] = True
        return np.flatnonzero(rows)

    def _check_joint_range(self, Q: Array, place: Place) -> None:
        low, high = self._joint_limits.T
        excess = np.maximum(low - Q, Q - high)
        if np.max(excess) > 1e-9:
            n, j = np.unravel_index(int(np.argmax(excess)), excess.shape)
            raise error(
                "MOTION_LIMIT",
                f"joint '{JOINTS[j]}' would be at {Q[n, j]:.3f} rad {place(int(n))}, "
                f"range {low[j]:.3f} to {high[j]:.3f} rad",
            )

    def _joint_samples(self, q0: Array, q1: Array) -> Array:
        """(n, 6) along the joint path: no point of the body moves more than ``SAMPLE_M`` between two."""
        travel = float(np.abs(q1 - q0) @ self._body.reach_after)
        count = max(1, int(np.ceil(travel / SAMPLE_M)))
        return q0 + np.linspace(0.0, 1.0, count + 1)[:, None] * (q1 - q0)

    def _follow_line(
        self, T0: RigidTransform, T1: RigidTransform, q0: Array, speed: float
    ) -> tuple[Array, float]:
        """Joints (n, 6) along the line, and the seconds between them at ``speed``."""
        poses, duration = self._line_poses(T0, T1, speed)
        Q = q0[None]
        for k in range(0, len(poses), _TOGETHER):
            some = slice(k, k + _TOGETHER)
            found = self._smoothly_along(poses[some], Q)
            Q = (
                np.concatenate([Q, self._step_by_step(poses[some], Q, _on_path(len(poses)))])
                if found is None
                else found
            )
        return Q[1:], duration / max(1, len(poses) - 1)

    def _smoothly_along(self, poses: Array, Q: Array) -> Array | None:
        """``Q`` (m, 6) and the joints of the next ``poses`` (n, 4, 4), found from one guess for all of them.

        None where they do not go on as smoothly as a branch does far from where it meets another.
        """
        # Extrapolated, the inverse starts next to its goal.
        rate = Q[-1] - Q[-2] if len(Q) > 2 else np.zeros(6)
        found = self.model.inverse_line(poses, Q[-1] + np.arange(1.0, len(poses) + 1.0)[:, None] * rate)
        if found is None:
            return None
        longer = np.concatenate([Q, found])
        smooth = np.max(np.abs(np.diff(longer[-len(found) - 1 :], axis=0))) < _SMOOTH_RAD
        return longer if smooth else None

    def _step_by_step(self, poses: Array, Q: Array, on_line: Place) -> Array:
        """Joints (n, 6) of the next ``poses`` (n, 4, 4) after ``Q`` (m, 6), each from the one before."""
        joints = list(Q[-2:])
        for k, pose in enumerate(poses, start=len(Q)):
            place = on_line(k - 1)  # Q begins with where the arm is
            near = 2.0 * joints[-1] - joints[-2] if k > 2 else joints[-1]
            q = self.model.inverse(RigidTransform.from_matrix(pose), near)
            if q is None:
                raise error(
                    "MOTION_UNREACHABLE", f"the flange pose {place} of the line has no joints within range"
                )
            jump = np.abs(q - joints[-1])
            if np.max(jump) > _JUMP_RAD:
                raise error(
                    "MOTION_UNREACHABLE",
                    f"joint '{JOINTS[int(np.argmax(jump))]}' would have to jump by {np.max(jump):.2f} rad "
                    f"{place} of the line; move there in joint space",
                )
            joints.append(q)
        return np.array(joints[-len(poses) :])

    def _line_poses(self, T0: RigidTransform, T1: RigidTransform, speed: float) -> tuple[Array, float]:
        """Flange poses (n, 4, 4) along the TCP's line, and its duration; turning is paced by the joints.

        By plain matrices: SciPy's products and :class:`Slerp` take longer than the joints of a short line.
        """
        tool = self.tool.T_flange_tool.as_matrix()
        a, b = T0.as_matrix() @ tool, T1.as_matrix() @ tool
        shift, turn = b[:3, 3] - a[:3, 3], Rotation.from_matrix(a[:3, :3].T @ b[:3, :3]).as_rotvec()
        length, angle = float(np.linalg.norm(shift)), float(np.linalg.norm(turn))
        count = max(1, int(np.ceil((length + angle * self._body.tool_reach) / SAMPLE_M)))
        s = np.linspace(0.0, 1.0, count + 1)[:, None]
        tcp = np.zeros((len(s), 4, 4))
        tcp[:, :3, :3] = a[:3, :3] @ Rotation.from_rotvec(s * turn).as_matrix()
        tcp[:, :3, 3] = a[:3, 3] + s * shift
        tcp[:, 3, 3] = 1.0
        # By the fastest joint: a slow one does not slow the turn down, it is what is looked for.
        duration = max(length / speed, angle / (_TURN_SHARE * float(self.limits.joint_speeds_rad_s.max())))
        return tcp @ self.tool.T_flange_tool.inv().as_matrix(), duration

    def _check_line_speed(self, Q: Array, step_s: float, speed: float) -> None:
        if len(Q) < 2 or step_s <= 0.0:
            return
        limits = self.limits.joint_speeds_rad_s
        if np.ptp(Q, axis=0).max() < _NOISE_RAD:
            return  # on a line of some micrometres noise of the start would pass for speed
        rates = np.abs(np.diff(Q, axis=0)) / step_s
        n, j = np.unravel_index(int(np.argmax(rates / limits)), rates.shape)
        if rates[n, j] > limits[j] * 1.01:
            raise error(
                "MOTION_LIMIT",
                f"joint '{JOINTS[j]}' would turn at {rates[n, j]:.2f} rad/s on this line at {speed:g} m/s "
                f"(limit {limits[j]:g} rad/s); go slower, or in joint space if a singular pose is near",
            )


def _six(q: Array) -> Array:
    values = np.asarray(q, dtype=float)
    if values.shape != (6,) or not np.all(np.isfinite(values)):
        raise error("MOTION_LIMIT", f"need 6 finite joint values, got {values.tolist()}")
    return values


def _sixes(Q: Array) -> Array:
    """Each of (n, 6) as :func:`_six` wants it."""
    values = np.asarray(Q, dtype=float)
    if values.ndim != 2 or values.shape[1] != 6 or not np.isfinite(values).all():
        return np.array([_six(q) for q in Q])
    return values


def _on_path(count: int) -> Place:
    """Which of ``count`` samples of a path, in words."""
    return lambda k: f"at {100 * k / max(1, count - 1):.0f} %"


def _path_limit(count: int) -> Array:
    """Slack that each sample needs: none at the target, where the arm will rest."""
    limit = np.full(count, -_MEASURED_M)
    limit[-1] = 0.0
    return limit


def _collision(finding: Finding, place: str) -> CellError:
    if finding.slack_m >= 0.0:
        kept = f"{1e3 * finding.needed_m:.1f} mm are kept so that an arm stopped there can leave"
        return error(
            "MOTION_COLLISION", f"{finding.text}: {1e3 * finding.slack_m:.1f} mm apart {place}; {kept}"
        )
    return error(
        "MOTION_COLLISION", f"{finding.text}: {-1e3 * finding.slack_m:.1f} mm beyond the limit {place}"
    )
