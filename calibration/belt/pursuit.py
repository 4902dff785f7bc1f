"""A tool's jerk-limited way to something that moves, and with it.

All motion is planned relative to an *origin*, which is a place in the base or an item that rides on the belt:
to meet an item is to come to rest in the item's own frame. Time-optimal profiles with limited jerk are
ruckig's (Berscheid and Kroeger, Jerk-limited real-time trajectory generation with arbitrary target states,
2021). Four axes: x, y, z in the base (m) and the yaw of the tool about base z (rad).
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from ruckig import InputParameter, Result, Ruckig, RuckigError, Synchronization, Trajectory

from calibration.belt.tracking import ItemTrack
from cell.errors import error
from cell.poses import Array

AXES = 4
_DT = 0.004  # s, over which the change of a forecast's speed is taken
_LEAST_SHARE = 0.1  # of the limit that is left for moving against a belt
_LEAST_AXIS = 0.25  # of the limit, for an axis that the way hardly uses
_KEEPS_UP = 1.5
_REACT_S = 0.1
# m, m/s and m/s^2, and of the yaw the same in rad. An axis that has so little to do arrives on its own: made
# to last as long as the others, ruckig sent one with a rounding error of 1e-16 away and back, by 20 mm beside
# a lift of 50 mm.
_IDLE = 1e-5
_MARGIN = 0.97  # of the limit: what follows a plan is a little faster than the plan between its points


@dataclass(frozen=True, eq=False)
class PursuitState:
    """Position, velocity and acceleration, (4,) each: m and rad, per s, per s^2."""

    p: Array
    v: Array
    a: Array

    @classmethod
    def still(cls, p: Array) -> "PursuitState":
        """At rest."""
        return cls(np.asarray(p, dtype=float), np.zeros(AXES), np.zeros(AXES))

    def __add__(self, other: "PursuitState") -> "PursuitState":
        return PursuitState(self.p + other.p, self.v + other.v, self.a + other.a)

    def __sub__(self, other: "PursuitState") -> "PursuitState":
        return PursuitState(self.p - other.p, self.v - other.v, self.a - other.a)


class Origin(Protocol):
    """What a motion is relative to, at any time."""

    def at(self, t: float) -> PursuitState: ...


@dataclass(frozen=True, eq=False)
class FixedPoint:
    """A place (4,) that does not move."""

    p: Array

    def at(self, t: float) -> PursuitState:
        del t
        return PursuitState.still(self.p)


class Ride:
    """An item as it is predicted now: its grasp point, and the ``yaw`` (rad) of the tool that fits it."""

    def __init__(self, track: ItemTrack, yaw: float) -> None:
        self.track = track
        self._forecast, self._way = track.forecast, np.array([*track.direction, 0.0])
        # Where the item would be at zero travel of the belt, as its place on the belt tells it.
        self._zero = np.array([*track.xy(np.array([track.forecast.now]))[0], track.height, yaw])
        self._zero[:2] -= track.forecast.travel(track.forecast.now) * self._way[:2]
        self._zero[2] -= track.forecast.travel(track.place.at) * self._way[2]

    def at(self, t: float) -> PursuitState:
        forecast, way = self._forecast, self._way
        before, now, after = (forecast.speed(max(at, forecast.now)) for at in (t - _DT, t, t + _DT))
        return PursuitState(
            self._zero + forecast.travels_at(t) * way,
            now * way,
            (after - before) / (2.0 * _DT) * way,
        )


@dataclass(frozen=True)
class PursuitLimits:
    """``v`` (m/s) bounds the tool's speed in the base, ``a`` and ``j`` (m/s^2, m/s^3) each of x, y and z; and
    those of the yaw (rad/s, rad/s^2, rad/s^3)."""

    v: float
    a: float
    j: float
    yaw_v: float = 2.0
    yaw_a: float = 12.0
    yaw_j: float = 160.0

    def slower(self, share: float) -> "PursuitLimits":
        """With ``share`` of the speeds; a tool that has to get slower must brake as hard as ever."""
        return replace(self, v=self.v * share, yaw_v=self.yaw_v * share)


def _shares(way: Array, v: Array, away: Array, limits: PursuitLimits) -> Array:
    """How the limit of the speed's size is shared among x, y and z (3,): as the tool goes in the base on its
    ``way`` (3,) to something that moves with ``away`` (3,), and as it moves now (``v`` (3,)).

    No axis gets so little that it could not keep up, or that a change of the goal could not be followed.
    """
    lasting = float(np.linalg.norm(way)) / limits.v + limits.v / limits.a
    size = np.abs(way + lasting * away) + _REACT_S * np.abs(v)
    share = size / max(float(np.linalg.norm(size)), 1e-9)
    share = np.maximum(share, np.maximum(_LEAST_AXIS, _KEEPS_UP * np.abs(away) / limits.v))
    out: Array = _MARGIN * share / np.linalg.norm(share)
    return out


class Leg:
    """One motion from a state to rest at an ``offset`` (4,) from an origin; from then on it stays there."""

    def __init__(
        self, t0: float, trajectory: Trajectory, origin: Origin, offset: Array, apart: bool = False
    ) -> None:
        self.t0, self.origin, self.offset, self.apart = t0, origin, offset, apart
        self._trajectory = trajectory

    @property
    def t1(self) -> float:
        """When it has arrived, s."""
        return float(self.t0 + self._trajectory.duration)

    def at(self, t: float) -> PursuitState:
        """The tool in the base at ``t``."""
        return self.origin.at(t) + self._relative(t)

    def gap(self, t: float) -> PursuitState:
        """What is left at ``t`` to where it ends, seen from the origin."""
        relative = self._relative(t)
        return PursuitState(relative.p - self.offset, relative.v, relative.a)

    def down_at(self, height: float) -> float:
        """When it is first so high (m) above its end; where it begins lower, at once."""
        above = float(self.offset[2]) + height
        if float(self._relative(self.t0).p[2]) <= above:
            return self.t0
        after = self._trajectory.get_first_time_at_position(2, above)
        return self.t1 if after is None else self.t0 + float(after)

    def _relative(self, t: float) -> PursuitState:
        p, v, a = self._trajectory.at_time(max(t - self.t0, 0.0))
        return PursuitState(np.array(p), np.array(v), np.array(a))


def _is_idle(relative: "PursuitState", goal: Sequence[float]) -> Array:
    """(4,) of axes that are at rest at the goal but for next to nothing."""
    left = np.abs([relative.p - goal, relative.v, relative.a])
    idle: Array = left.max(axis=0) < _IDLE
    return idle


def plan(
    t0: float, state: PursuitState, origin: Origin, offset: Array, limits: PursuitLimits, apart: bool = False
) -> Leg:
    """The fastest way from ``state`` at ``t0`` to rest at ``offset`` (4,) from ``origin``.

    All axes arrive together, but a tool that has to rise does so at once. With ``apart`` each axis arrives as
    early as it can, so that what is beside is over before the tool is down.

    A state beyond the limits is first brought back within them. ``PLAN_INFEASIBLE`` when ruckig finds none.
    """
    away = origin.at(t0)
    relative = state - away
    wanted = InputParameter(AXES)
    wanted.current_position, wanted.current_velocity = relative.p.tolist(), relative.v.tolist()
    wanted.current_acceleration = relative.a.tolist()
    wanted.target_position = np.asarray(offset, dtype=float).tolist()
    shares = _shares((offset - relative.p)[:3], relative.v[:3], away.v[:3], limits)
    own = np.array([*(limits.v * shares), limits.yaw_v])
    wanted.max_velocity = np.maximum(own - away.v, _LEAST_SHARE * own).tolist()
    wanted.min_velocity = (-np.maximum(own + away.v, _LEAST_SHARE * own)).tolist()
    wanted.max_acceleration = [limits.a] * 3 + [limits.yaw_a]
    wanted.max_jerk = [limits.j] * 3 + [limits.yaw_j]
    each = [Synchronization.No] * AXES
    together = [Synchronization.Time] * AXES
    if offset[2] > relative.p[2]:
        together[2] = Synchronization.No
    for k in np.flatnonzero(_is_idle(relative, wanted.target_position)):
        together[k] = Synchronization.No
    for synchronization in (each,) if apart else (together, each):
        wanted.per_dof_synchronization = synchronization
        trajectory = Trajectory(AXES)
        # A few states leave no common duration, each axis alone has one. One that is too long is a code that
        # ruckig's binding does not know.
        with suppress(RuckigError, ValueError):
            if Ruckig(AXES).calculate(wanted, trajectory) in (Result.Working, Result.Finished):
                return Leg(t0, trajectory, origin, np.asarray(offset, dtype=float), apart)
    raise error("PLAN_INFEASIBLE", f"no motion within the limits from {np.round(relative.p, 4).tolist()}")
