"""The tool's present way, as fast as the limits of tool and joints let, and the set-points along it."""

from collections.abc import Callable, Sequence
from math import hypot

import numpy as np

from calibration.belt.descent import descend, touch_height
from calibration.belt.pursuit import FixedPoint, Leg, Origin, PursuitLimits, PursuitState, Ride, plan
from cell.devices import TrajectoryPiece
from cell.guard import MotionGuard
from cell.joint_limits import per_joint
from cell.poses import Array
from procedures.belt.config import JobLimits
from procedures.belt.motion.blend import Blend
from procedures.belt.motion.tool_joints import (
    ToolJoints,
    fastest_on_piece,
    joints_on_piece,
    looks_along,
    looks_on_piece,
    on_piece,
)

STEP_S = 0.02  # between decisions
LEAD_S = 0.012  # from a decision to the set-points that come of it
AHEAD_S, NODES = 0.05, (1, 2, 3)  # a piece goes on for longer than a loop that is late once
HALVES = (0.5, 1.0, 1.5, 2.0, 2.5, 3.0)  # the nodes and between them
SLOWER = (1.1, 1.25, 1.5, 2.0, 3.0, 4.0)  # so many times the time for a piece that is too fast
JOINT_SHARE = 0.85  # of the joints' speed limit that a plan may use; a change of plan needs the rest
BRAKE_SHARE = 0.9
TOOL_SHARE = 0.99  # of the tool's speed limit: a goal that jumps shares it anew among axes that are all fast
KEPT_SHARE = 0.995  # of it that a piece may use: the next one begins between the places that were looked at
SLOWINGS, LEAST_SLOWING = 5, 1.1  # a way that never reaches the speed limit feels a lower one late
LEAST_SHARE = 0.2  # slower would not help: a tool that still gets faster is first to lose its acceleration
YAW_SHARE = 0.6  # of the joints' speed limit for turning the tool; the way itself turns the wrist too


def pursuit_limits(limits: JobLimits) -> PursuitLimits:
    """The job's limits as the planner takes them."""
    yaw_v = YAW_SHARE * float(per_joint(limits.joint_speed_rad_s).min())
    return PursuitLimits(limits.speed_m_s, limits.accel_m_s2, limits.jerk_m_s3, yaw_v=yaw_v)


def within_joint_speed(
    planned: Callable[[float], Leg], fastest: Callable[[Leg], Array], limits: Array
) -> tuple[Leg, float]:
    """The leg that is ``planned`` for a share of the tool's speed, and that share: the greatest with which
    the ``fastest`` (6,) that joints are on it keep to ``limits`` (6,) rad/s, but for what a few tries
    leave."""
    share, leg = 1.0, planned(1.0)
    for _ in range(SLOWINGS):
        over = float(np.max(fastest(leg) / (JOINT_SHARE * limits)))
        if over <= 1.0:
            break
        share /= max(over, LEAST_SLOWING)
        leg = planned(share)
    return leg, share


class ToolPath:
    """One leg after the other, each from the state that the one before is in. Times in s of the cell's clock,
    offsets (4,) from an origin: x, y, z in the base (m) and yaw (rad)."""

    def __init__(self, tool: ToolJoints, limits: JobLimits, guard: MotionGuard, at: PursuitState) -> None:
        self._tool, self._guard = tool, guard
        self._job, self._limits = limits, pursuit_limits(limits)
        self._joint_speeds = per_joint(limits.joint_speed_rad_s)
        self._leg = plan(0.0, at, FixedPoint(at.p), np.zeros(4), self._limits)
        self._share = 1.0  # of the full speed, on the present way
        self._q: Array = np.zeros(6)
        self._latest: TrajectoryPiece | None = None
        self._behind = False  # whether the latest piece took more time than its plan

    @property
    def t1(self) -> float:
        """When the tool has arrived."""
        return self._leg.t1

    def at(self, t: float) -> PursuitState:
        """The tool at ``t``."""
        return self._leg.at(t)

    def touches(self, grip: Array) -> tuple[float, Array]:
        """When the tool may touch an item that it grips at ``grip`` (4,) from the middle of its face, and
        where it then is (2,) in the base, m; never, for a way that ends above the face."""
        height = float(grip[2]) + touch_height(grip) - float(self._leg.offset[2])
        t = self._leg.down_at(height) if height >= 0.0 else np.inf
        return t, self._leg.at(min(t, self._leg.t1)).p[:2]

    # -- where to

    def start(self, t: float, q: Array, place: FixedPoint) -> None:
        """From rest at joints ``q`` (6,)."""
        self._q, self._share, self._latest, self._behind = q, 1.0, None, False
        self._leg = plan(t, self._tool.state(q), place, np.zeros(4), self._limits)

    def begin(self, t: float, origin: Origin, offset: Array) -> None:
        """A new way, as fast as the limits and the joints let."""
        self.take(self.tried(t, origin, offset))

    def tried(self, t: float, origin: Origin, offset: Array) -> tuple[Leg, float]:
        """What :meth:`begin` would set out on, to be looked at and taken or not."""
        state = self._leg.at(t)
        return within_joint_speed(
            lambda share: plan(t, state, origin, offset, self._limits.slower(share)),
            lambda leg: self._tool.fastest(leg, self._q),
            self._joint_speeds,
        )

    def check(self, tried: tuple[Leg, float], states: Sequence[PursuitState] = ()) -> None:
        """What was tried, and the tool at ``states`` after it, before the motion guard: the error that a
        set-point of it would end the job with."""
        Q, _ = self._tool.line([*looks_along(tried[0]), *states], self._q)
        for q in Q[~self._guard.free(Q)]:
            self._guard.check_joints(q)

    def take(self, tried: tuple[Leg, float]) -> None:
        """Set out on what was tried."""
        self._leg, self._share = tried

    def soonest(self, t: float, origin: Origin, offset: Array) -> float:
        """When the tool could be there if the joints let."""
        return plan(t, self._leg.at(t), origin, offset, self._limits).t1

    def go(self, t: float, origin: Origin, offset: Array, apart: bool = False) -> None:
        """From where the tool is at ``t`` to rest at ``offset`` from ``origin``; a way to a place is kept."""
        old = self._leg
        if (
            isinstance(origin, FixedPoint)
            and isinstance(old.origin, FixedPoint)
            and np.array_equal(origin.p, old.origin.p)
            and np.array_equal(offset, old.offset)
        ):
            return
        self._leg = plan(t, old.at(t), origin, offset, self._limits.slower(self._share), apart)

    def descend(self, t: float, ride: Ride, offset: Array, cautious: bool) -> None:
        """On down to an item; see :func:`calibration.belt.descent.descend`."""
        limits = self._limits.slower(self._share)
        self._leg = descend(t, self._leg.at(t), ride, offset, limits, cautious)

    def rise(self, t: float, offset: Array) -> None:
        """Straight up at full speed, seen from what the tool is at."""
        self._leg = plan(t, self._leg.at(t), self._leg.origin, offset, self._limits)

    def has_risen(self, t: float, foot_m: float, blend: Blend) -> bool:
        """Whether the tool is so far above ``foot_m`` at ``t`` that it may go sideways."""
        return t >= self._leg.t1 or float(self._leg.at(t).p[2]) - foot_m >= blend.clear_m

    def at_full_speed(self) -> None:
        """From the next plan on."""
        self._share = 1.0

    # -- the set-points

    def catch_up(self, t: float, here: tuple[Array, Array]) -> None:
        """Before anything is decided at ``t``: a plan that is ahead of the arm, which is sent to joints and
        joint speeds ``here`` (6,), begins anew from there."""
        if self._behind:
            old, slower = self._leg, self._limits.slower(self._share)
            self._leg = plan(t, self._tool.moving(*here), old.origin, old.offset, slower, old.apart)

    def piece(self, t: float, here: tuple[Array, Array]) -> TrajectoryPiece:
        """The next piece from ``here`` on, joints and joint speeds (6,) at ``t``; a way that gets too fast
        for joints or tool is slowed down."""
        self._q = here[0]
        guesses = self._guesses(t, here)
        for _ in range(4):
            halves = [self._leg.at(t + k * AHEAD_S) for k in HALVES]
            ahead = halves[1::2]
            Q, Qd = self._tool.line(ahead, guesses)
            piece = self._tool.piece(t, AHEAD_S, [here, *zip(Q, Qd, strict=True)])
            fastest = max(hypot(*state.v[:3].tolist()) for state in halves)
            slow = fastest <= TOOL_SHARE * self._job.speed_m_s
            share = float(np.max(fastest_on_piece(piece) / self._joint_speeds))
            if (slow and share <= BRAKE_SHARE) or self._share <= LEAST_SHARE:
                break
            self._share = max(0.8 * self._share, LEAST_SHARE)
            slower, old = self._limits.slower(self._share), self._leg
            self._leg = plan(t, old.at(t), old.origin, old.offset, slower, old.apart)
        slowed = None if self._keeps(piece) else self._slowed(t, here, Q, Qd)
        self._behind, piece = slowed is not None, slowed or piece
        self._latest = piece
        return piece

    def _slowed(self, t: float, here: tuple[Array, Array], Q: Array, Qd: Array) -> TrajectoryPiece | None:
        """The same way in more time, through ``Q`` and speeds ``Qd`` (n, 6) at the nodes, for a plan that got
        too fast sooner than a slower plan helps, or goes with something that is too fast. None where that is
        not enough."""
        for times in SLOWER:
            nodes = [here, *zip(Q, Qd / times, strict=True)]
            piece = self._tool.piece(t, times * AHEAD_S, nodes)
            if self._keeps(piece):
                return piece
        return None

    def _keeps(self, piece: TrajectoryPiece) -> bool:
        """Whether joints and tool keep to their speeds; the guard ends the job at a set-point that does
        not."""
        Q, Qd = looks_on_piece(piece)
        joints = np.all(np.max(np.abs(Qd), axis=0) <= self._joint_speeds)
        return bool(joints and np.max(self._tool.speeds(Q, Qd)) <= KEPT_SHARE * self._job.speed_m_s)

    def _guesses(self, t: float, here: tuple[Array, Array]) -> Array:
        """About where the joints are at the next piece's nodes (n, 6): a plan seldom changes by much, so that
        is where the piece before goes, and on from its end as fast as there."""
        latest = self._latest
        if latest is None or t > latest.t1:
            return here[0] + AHEAD_S * np.array(NODES)[:, None] * here[1]
        end, speed = on_piece(latest, latest.t1)
        times = [t + k * AHEAD_S for k in NODES]
        return np.array(
            [
                joints_on_piece(latest, at) if at < latest.t1 else end + (at - latest.t1) * speed
                for at in times
            ]
        )
