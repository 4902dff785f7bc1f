"""The arm as programs command it: a track, the believed kinematics and the active tool.

The controller plans and reports with the kinematics it believes in. Where the flange truly is, is the
world's business; only the joints are common to both.
"""

from collections.abc import Callable, Generator
from dataclasses import dataclass
from functools import lru_cache
from math import isfinite
from operator import le

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform

from cell.poses import Array, from_pose6
from fakes.ur.runtime import ScriptError, Steps
from fakes.world.arm.kinematics import Chain, UnreachableError, rotation_vector
from fakes.world.arm.linear_path import LinearPath
from fakes.world.arm.servo import Servo, lag_s
from fakes.world.arm.track import Track

Plan = Generator[None, None, float]  # a cycle per step; returns when the arm will be at rest
SAMPLES_PER_CYCLE = 3
SHORTEST_WAY_M = 1e-9
HALT_RAD_S2 = 6.0  # how hard the arm brakes when its program ends
SILENT_S = 0.1  # a client that saw nothing of the arm for longer has stopped it
ZERO6 = (0.0,) * 6


@dataclass
class Tool:
    """TCP and payload as set by the program."""

    offset6: tuple[float, ...] = ZERO6
    payload: float = 0.0
    centre_of_gravity: tuple[float, ...] = (0.0, 0.0, 0.0)
    inertia: tuple[float, ...] = ZERO6
    gravity: tuple[float, ...] = (0.0, 0.0, 9.82)  # the default of set_gravity()

    @property
    def T_flange_tcp(self) -> RigidTransform:
        return _transform(self.offset6)


@lru_cache(maxsize=8)
def _transform(pose6: tuple[float, ...]) -> RigidTransform:
    """A tool is asked for in every cycle and hardly ever changes."""
    return from_pose6(pose6)


class Arm:
    """Motion primitives; times are the controller cycle's own time (s on the twin's clock)."""

    def __init__(
        self, track: Track, believed: Chain, tool: Tool, servo: Servo | None, joint_ranges: Array
    ) -> None:
        self.track, self.believed, self.tool = track, believed, tool
        self._servo = servo
        self._lowest, self._highest = joint_ranges.T.tolist()
        self.t = 0.0  # the present cycle
        self.halts = 0  # grows whenever something other than the program stops the arm
        self.speed_fraction = 1.0
        self.period = 0.002  # of the control cycle
        self.refusal = ""  # why motion commands are refused, when they are
        self._waypoint: Array | None = None
        self._stood_s, self._has_jumped = 0.0, False

    def stood_still(self, seconds: float, t: float) -> None:
        """The twin's process did, until ``t``; a controller, which has a computer of its own, would not have.

        What the client sent meanwhile is read only now. So a move goes on from where it was: a stop that
        came soon after comes soon after. And the arm is where the next set-point has it, as if it had
        followed all before.
        """
        if seconds > SILENT_S:
            self._stood_s, self._has_jumped = self._stood_s + seconds, True
            self.track.delay(t, seconds)

    def moving(self, t: float) -> bool:
        """True while a joint turns or a planned move is not finished."""
        return self.track.is_moving(t)

    def halt(self, t: float, decel: float = HALT_RAD_S2) -> None:
        """Brake, whoever commanded the motion; a paused program continues its move later."""
        self.halts += 1
        if self.moving(t):
            self.track.halt(t, decel)

    @property
    def q(self) -> Array:
        """Joints in the present cycle, rad."""
        return self.track.at(self.t)[0]

    # -- kinematics as the controller believes them

    def pose6(self, q: ArrayLike, offset6: ArrayLike | None = None) -> Array:
        """TCP pose in the base for ``q``, with the active tool or another."""
        tool = (self.tool.T_flange_tcp if offset6 is None else from_pose6(offset6)).as_matrix()
        pose = self.believed.matrix(q) @ tool
        return np.concatenate([pose[:3, 3], rotation_vector(pose[:3, :3])])

    def inverse(self, pose6: ArrayLike, q_near: ArrayLike | None = None) -> Array:
        """Joints for a TCP pose near ``q_near`` (default: now); a script error when there are none."""
        near = self.q if q_near is None else q_near
        try:
            q = self.believed.inverse(from_pose6(pose6) * self.tool.T_flange_tcp.inv(), near)
        except UnreachableError as exc:
            raise ScriptError(f"get_inverse_kin: no inverse kinematics solution: {exc}") from None
        return q

    def jacobian(self, q: ArrayLike) -> Array:
        """Of the TCP, (6, 6) in the base."""
        return self.believed.jacobian(q, self.tool.offset6[:3])

    def elbow(self, q: ArrayLike) -> Array:
        """Elbow in the base (3,) for ``q``: the point of axis 3 that is nearest the base's origin at zero."""
        moment, axis = self.believed.screws[2].reshape(2, 3)
        carried = self.believed.partial(q)[2]
        position: Array = carried[:3, :3] @ np.cross(axis, moment) + carried[:3, 3]
        return position

    @property
    def waypoint(self) -> Array:
        """TCP pose (6,) at which the active move ends; without one, where the arm is."""
        return self.pose6(self.q) if self._waypoint is None else self._waypoint

    def tcp_speed(self, q: Array, qd: Array) -> Array:
        """Velocity of the TCP in the base, (6,) m/s and rad/s."""
        return self.jacobian(q) @ qd

    def within_limits(self, q: ArrayLike) -> bool:
        """Whether every joint lies inside its range."""
        values = np.asarray(q).tolist()
        return all(map(le, self._lowest, values)) and all(map(le, values, self._highest))

    # -- blocking motion: one ``next`` per control cycle until the arm is there

    def move_joints(self, q: ArrayLike, v: float, a: float) -> Steps:
        """movej to joints."""
        goal = _finite(q)
        if not self.within_limits(goal):
            raise ScriptError("movej: target joints are outside the joint limits")

        def plan() -> Plan:
            yield from ()
            return self.track.start_joint_move(self.t, goal, _positive(v) * self.speed_fraction, _positive(a))

        yield from self._until(plan, self.pose6(goal))

    def move_linear(self, pose6: ArrayLike, v: float, a: float) -> Steps:
        """movel of the TCP to a pose."""
        goal = from_pose6(_finite(pose6))

        yield from self._until(
            lambda: self._plan_linear(goal, _positive(v) * self.speed_fraction, _positive(a)),
            np.asarray(pose6, dtype=float),
        )

    def _plan_linear(self, goal: RigidTransform, v: float, a: float) -> Plan:
        """Brake if need be, and meanwhile find the path, a few samples a cycle: the stream must not wait."""
        if self.moving(self.t):
            self.track.stop_joint(self.t, a)
        rest = max(self.track.end_time, self.t)
        path = LinearPath(self.believed, self.track.at(rest)[0], goal, self.tool.T_flange_tcp)
        if path.length < SHORTEST_WAY_M:
            return rest
        halts = self.halts
        try:
            while not path.complete:
                for _ in range(SAMPLES_PER_CYCLE):
                    if not path.complete:
                        path.sample()
                yield
        except UnreachableError as exc:
            raise ScriptError(f"movel: {exc}") from None
        if self.halts == halts:  # else the arm rests elsewhere, and the move is planned anew
            self.track.append(path.segment(max(self.t, rest), v, a))
        return self.track.end_time

    def stop(self, decel: float, linear: bool) -> Steps:
        """stopj (rad/s^2) or stopl (m/s^2): brake and wait for standstill."""
        if self.moving(self.t):
            brake = self.track.stop_linear if linear else self.track.stop_joint
            brake(self.t, _positive(decel))
            while self.moving(self.t):
                yield

    def _until(self, plan: Callable[[], Plan], waypoint: Array) -> Steps:
        """Wait for a planned move; one that was halted meanwhile is planned anew from where the arm is."""
        self._require_position_control()
        self._waypoint = waypoint
        try:
            halts = self.halts
            end = (yield from plan()) - self._stood_s
            while self.t < end + self._stood_s or self.halts != halts:
                if self.halts != halts:
                    halts = self.halts
                    end = (yield from plan()) - self._stood_s
                else:
                    yield
        finally:
            self._waypoint = None

    def _require_position_control(self) -> None:
        if self.refusal:
            raise ScriptError(f"the move is refused: {self.refusal}")

    # -- motion that is renewed every cycle

    def speed_joints(self, qd: ArrayLike, a: float) -> None:
        """speedj: towards joint speeds."""
        self._require_position_control()
        self.track.speed_joints(self.t, _finite(qd), _positive(a))

    def speed_linear(self, xd: ArrayLike, a: float) -> None:
        """speedl: towards a TCP velocity in the base; ``a`` in m/s^2 along the strongest direction."""
        self._require_position_control()
        self.drive_linear(xd, a)

    def drive_linear(self, xd: ArrayLike, a: float) -> None:
        """The same, whatever controls the arm."""
        q, qd = self.track.at(self.t)
        J = self.jacobian(q)
        wanted = _finite(xd)
        step = wanted - J @ qd
        change = float(np.max(np.abs(step)))
        limit = _positive(a) * self.period
        if change > limit:
            wanted = J @ qd + step * (limit / change)
        try:
            speeds = np.linalg.solve(J, wanted)
        except np.linalg.LinAlgError:
            raise ScriptError("speedl: the arm is at a singularity") from None
        # Joint acceleration is bounded by the TCP's, so the joints may follow within the cycle.
        self.track.speed_joints(self.t, speeds, max(float(np.max(np.abs(speeds - qd))) / self.period, 1.0))

    def servo(self, q: ArrayLike, dt: float, lookahead_s: float, gain: float) -> None:
        """servoj: be at ``q`` in ``dt`` seconds, or as late as look-ahead and gain make the arm."""
        self._require_position_control()
        goal, dt = _finite(q), max(dt, self.period)
        if self._has_jumped:
            self.track.hold(self.t, goal)
            self._has_jumped = False
        if self._servo is not None:
            late_s = lag_s(_positive(lookahead_s), _positive(gain))
            goal = self._servo.step(self.t, lambda: self.q, goal, late_s, self.period, self.speed_fraction)
        self.track.servo(self.t, goal, dt)

    @property
    def limiting(self) -> float:
        """What the limits of the joints leave of the speed that is wanted while set-points are followed."""
        return 1.0 if self._servo is None else self._servo.limiting(self.t)


def _finite(values: ArrayLike) -> Array:
    out = np.asarray(values, dtype=float)
    if out.shape != (6,) or not all(map(isfinite, out.tolist())):
        raise ScriptError("a motion target needs six finite numbers")
    return out


def _positive(value: float) -> float:
    if not 0.0 < value < float("inf"):
        raise ScriptError(f"speeds and accelerations are positive, not {value:g}")
    return value
