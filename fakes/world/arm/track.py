"""The arm's joints as a function of time: a list of segments, never ticks.

A command given at ``t`` replaces whatever was planned from ``t`` on; what was before stays as history.
Segments are handed to ``listeners``, so a track in another process that appends the same segments is equal
to this one at every time.
"""

from bisect import bisect_right
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform

from cell.poses import Array
from fakes.world.arm.kinematics import Chain
from fakes.world.arm.linear_path import LinearPath
from fakes.world.arm.profile import Ramp, Trapezoid
from fakes.world.arm.ripple import Ripple, Rippled
from fakes.world.arm.segments import (
    Hold,
    JointMove,
    JointSpeed,
    JointStop,
    PathMove,
    Polynomial,
    Segment,
    largest,
)
from fakes.world.arm.smoothed import Smoothed
from fakes.world.arm.truth import Lag

MAX_JOINT_RAD_S = 3.5  # a servo set-point further away is approached at this speed


class Track:
    """Commanded and encoder joints of one arm; times are seconds on the twin's clock."""

    def __init__(self, t: float, q: ArrayLike, keep_s: float = 10.0) -> None:
        self.listeners: list[Callable[[Segment], None]] = []
        self.keep_s = keep_s
        self._segments: list[Segment] = [Hold(t, np.array(q, dtype=float))]
        self._starts: list[float] = [t]

    @property
    def end_time(self) -> float:
        """When the planned motion comes to rest; ``inf`` under constant joint speed."""
        return self._segments[-1].t_end

    def at(self, t: float) -> tuple[Array, Array]:
        """Joints (rad) and joint speeds (rad/s) at ``t``; before the history the oldest known joints."""
        segment = self.segment_at(t)
        if t < segment.t0:
            q = segment.at(segment.t0)[0]
            return q, np.zeros_like(q)
        return segment.at(t)

    def segment_at(self, t: float) -> Segment:
        """The segment in force at ``t``."""
        return self._segments[max(bisect_right(self._starts, t) - 1, 0)]

    def is_moving(self, t: float) -> bool:
        """True while any joint turns at ``t`` or is planned to afterwards."""
        return self.end_time > t or bool(np.any(self.at(t)[1]))

    def append(self, segment: Segment) -> None:
        """Put ``segment`` in force from its ``t0``: later plans go, old history is dropped."""
        keep = bisect_right(self._starts, segment.t0)
        if keep and self._starts[keep - 1] == segment.t0:
            keep -= 1
        self._segments[keep:], self._starts[keep:] = [segment], [segment.t0]
        old = max(bisect_right(self._starts, segment.t0 - self.keep_s) - 1, 0)
        del self._segments[:old], self._starts[:old]
        for listener in tuple(self.listeners):
            listener(segment)

    def snapshot(self) -> list[Segment]:
        """The segments kept, oldest first: what a mirror starts from."""
        return list(self._segments)

    def load(self, segments: list[Segment]) -> None:
        """Become a copy of the track whose :meth:`snapshot` this is."""
        self._segments, self._starts = [], []
        for segment in segments:
            self.append(segment)

    # -- commands; each returns the time at which the arm is at rest

    def hold(self, t: float, q: ArrayLike | None = None) -> float:
        """Stand still from ``t`` on, at once (brakes), or appear at ``q``."""
        self.append(Hold(t, self.at(t)[0] if q is None else np.array(q, dtype=float)))
        return t

    def delay(self, t: float, seconds: float) -> None:
        """A planned move that is under way stood still for so long until ``t``, and goes on from there.

        What was before that stays as it was: somebody may have seen it.
        """
        since = t - seconds
        segment = self.segment_at(since)
        if isinstance(segment, JointMove | PathMove) and segment is self._segments[-1]:
            self.append(Hold(since, segment.at(since)[0]))
            self.append(replace(segment, t0=t, gone_s=since - segment.begun))

    def pace(self, t: float, change: float) -> None:
        """What is followed from ``t`` on comes ``change`` times as fast; braking at its end stays as hard.

        Where a stop is planned already, it stays as it is.
        """
        if not isinstance(self._segments[-1], Polynomial | Smoothed | Rippled):
            return
        first = max(bisect_right(self._starts, t) - 1, 0)
        for segment in self._segments[first:]:
            way, ripple = (segment.way, segment.ripple) if isinstance(segment, Rippled) else (segment, None)
            if isinstance(way, Polynomial) and t < way.t1:
                self._follow(way.paced(t, t, change), ripple)
            elif isinstance(way, Smoothed) and t < way.sent.t1:
                q0 = way.at(t)[0] if way.t0 < t else way.q0
                self._follow(Smoothed(way.sent.paced(t, t, change), way.tau / change, q0), ripple)

    def start_joint_move(self, t: float, q_target: ArrayLike, v: float, a: float) -> float:
        """Synchronised joint move, ``v`` (rad/s) and ``a`` (rad/s^2) for the joint with the longest way.

        An arm that still moves brakes first.
        """
        t, q0 = self._rest_first(t, a)
        q1 = np.array(q_target, dtype=float)
        self.append(JointMove(t, q0, q1, Trapezoid(float(np.max(np.abs(q1 - q0))), v, a)))
        return self.end_time

    def start_linear_move(
        self,
        t: float,
        believed: Chain,
        T_base_tcp: RigidTransform,
        T_flange_tcp: RigidTransform,
        v: float,
        a: float,
    ) -> float:
        """TCP on a straight line, rotation about one axis, ``v`` (m/s) and ``a`` (m/s^2) along the way.

        See :class:`fakes.world.arm.linear_path.LinearPath`. Raises
        :class:`fakes.world.arm.kinematics.UnreachableError` before anything moves.
        """
        _, q_rest = self._rest_state(t, a)
        path = LinearPath(believed, q_rest, T_base_tcp, T_flange_tcp)
        while path.length >= 1e-9 and not path.complete:
            path.sample()
        t, _ = self._rest_first(t, a)
        if path.length >= 1e-9:
            self.append(path.segment(t, v, a))
        return self.end_time

    def stop_joint(self, t: float, decel: float) -> float:
        """Brake in joint space with ``decel`` (rad/s^2) for the fastest joint."""
        q, qd = self.at(t)
        self.append(JointStop(t, q, qd, decel) if np.any(qd) else Hold(t, q))
        return self.end_time

    def stop_linear(self, t: float, decel: float) -> float:
        """Brake on the path with ``decel`` (m/s^2); off a path the fastest joint takes it as rad/s^2."""
        segment = self.segment_at(t)
        if not isinstance(segment, PathMove):
            return self.stop_joint(t, decel)
        s, speed = segment.profile.at(t - segment.begun)
        self.append(PathMove(t, segment.knots, segment.coefficients, self._ramp(segment, s, speed, decel)))
        return self.end_time

    def halt(self, t: float, decel: float) -> float:
        """Brake as a controller does by itself (program ended, protective stop): on its way, never past the
        end of it. What a program asks for with :meth:`stop_joint` may carry further."""
        segment = self.segment_at(t)
        if isinstance(segment, JointMove):
            gone, speed = segment.profile.at(t - segment.begun)
            room = segment.profile.length - gone
            if speed > 0.0 and room > 0.0:
                decel = max(decel, 0.5 * speed * speed / room)
        return self.stop_linear(t, decel)

    def speed_joints(self, t: float, qd: ArrayLike, a: float) -> float:
        """Change to constant joint speeds (rad/s) with ``a`` (rad/s^2)."""
        q0, qd0 = self.at(t)
        self.append(JointSpeed(t, q0, qd0, np.array(qd, dtype=float), a))
        return self.end_time

    def servo(self, t: float, q: ArrayLike, dt: float) -> float:
        """Be at ``q`` in ``dt`` seconds: a cubic whose end speed follows from the set-point before."""
        q0, qd0 = self.at(t)
        q1 = np.array(q, dtype=float)
        T = max(dt, largest(q1 - q0) / MAX_JOINT_RAD_S)
        last = self._segments[-1]
        qd1 = np.zeros(6)
        if isinstance(last, Polynomial) and last.t1 >= t - 2.0 * dt:
            qd1 = np.minimum(np.maximum((q1 - last.end[0]) / dt, -MAX_JOINT_RAD_S), MAX_JOINT_RAD_S)
        c2 = (3.0 * (q1 - q0) / T - 2.0 * qd0 - qd1) / T
        c3 = (2.0 * (q0 - q1) / T + qd0 + qd1) / (T * T)
        self.append(Polynomial(t, t + T, t, np.array([q0, qd0, c2, c3])))
        return self.end_time

    def follow(
        self, sent: Polynomial, lag: Lag = "none", late_s: float = 0.0, ripple: Ripple | None = None
    ) -> float:
        """Follow joint polynomials to their end, then brake unless more comes; ``late_s`` behind them, and
        beside them by ``ripple``."""
        match lag:
            case "none":
                self._follow(sent, ripple)
            case "delay":
                late = sent.t0 + late_s, sent.t1 + late_s, sent.origin + late_s
                self._follow(Polynomial(*late, sent.coefficients), ripple)
            case "low-pass":
                before = self.segment_at(sent.t0)
                q0 = before.way.at(sent.t0)[0] if isinstance(before, Rippled) else self.at(sent.t0)[0]
                self._follow(Smoothed(sent, late_s, q0), ripple)
        return self.end_time

    def _follow(self, way: Polynomial | Smoothed, ripple: Ripple | None) -> None:
        self.append(way if ripple is None else Rippled(way, ripple))

    def _rest_state(self, t: float, decel: float) -> tuple[float, Array]:
        """When and where an arm that brakes from ``t`` on comes to rest; nothing is changed."""
        q, qd = self.at(t)
        if not np.any(qd):
            return t, q
        stop = JointStop(t, q, qd, decel)
        return stop.t_end, stop.at(stop.t_end)[0]

    def _rest_first(self, t: float, decel: float) -> tuple[float, Array]:
        rest, q = self._rest_state(t, decel)
        if rest > t:
            self.stop_joint(t, decel)
        return rest, q

    @staticmethod
    def _ramp(segment: PathMove, s: float, speed: float, decel: float) -> Ramp:
        """A ramp that never leaves the path: braking may have to be harder near its end."""
        room = float(segment.knots[-1]) - s
        if speed > 0.0 and room > 0.0:
            decel = max(decel, 0.5 * speed * speed / room)
        return Ramp(s, speed, decel)
