"""What can be expected of picking before anything moves: reach of the zone, time in it, and the arm's cycle.

The cycle is planned leg by leg with the planner that the job itself uses, on a belt of constant speed, for
items of the least height: met in the middle of the zone, and at its end, where a job that has more items than
it can pick meets them. Where the gripper's section does not tell its time, a third of ``grip_timeout_s``
stands for it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from calibration.belt.arm_time import MotionLimits, rest_to_rest, slower_axis
from calibration.belt.pursuit import FixedPoint, Leg, Origin, PursuitState, plan
from cell.errors import CellError
from cell.guard import MotionGuard
from cell.joint_limits import JOINTS, per_joint
from cell.poses import Array
from procedures.belt.config import BeltTrackingConfig
from procedures.belt.motion.blend import blend_for
from procedures.belt.motion.places import Places
from procedures.belt.motion.tool_joints import ToolJoints
from procedures.belt.motion.tool_path import pursuit_limits, within_joint_speed

SPEEDS_M_S = (0.1, 0.2, 0.3)
SLOWEST_SHARE = 0.1  # of the first of these speeds: a belt that is being set up


@dataclass(frozen=True)
class ExpectedCycle:
    """At ``speed_m_s`` of the belt: time in the zone, slide within the dwell without following, and cycles.

    ``cycle_s`` are those with items met in the middle of the zone and at its end; None where the arm cannot
    meet an item, and ``why`` says so.
    """

    speed_m_s: float
    window_s: float
    slide_m: float
    cycle_s: tuple[float, float] | None
    why: str = ""

    @property
    def per_minute(self) -> tuple[float, float] | None:
        """How many items the arm alone can pick, least and most."""
        if self.cycle_s is None:
            return None
        return 60.0 / max(self.cycle_s), 60.0 / min(self.cycle_s)

    def as_dict(self) -> dict[str, Any]:
        """Plain values."""
        keys = ("speed_m_s", "window_s", "slide_m", "cycle_s", "per_minute")
        return {key: getattr(self, key) for key in keys}


@dataclass(frozen=True, eq=False)
class _Carried:
    """An item at ``p`` (4,) at ``t0`` on a belt of constant velocity ``v`` (3,)."""

    p: Array
    v: Array
    t0: float

    def at(self, t: float) -> PursuitState:
        velocity = np.array([*self.v, 0.0])
        return PursuitState(self.p + (t - self.t0) * velocity, velocity, np.zeros(4))


@dataclass(frozen=True)
class ZoneTimes:
    """What an item at the zone's first edge needs of the zone when the arm sets out for it, s.

    ``approach_s`` is T1 of the classic method, which is fixed, else the longest way above the zone;
    ``farthest_s`` is that longest way for both. ``fastest_m_s``: on a faster belt the item leaves the zone
    before the grip is over.
    """

    approach_s: float
    descent_s: float
    grip_s: float
    farthest_s: float
    length_m: float

    @property
    def needed_s(self) -> float:
        """Approach, descent and grip."""
        return self.approach_s + self.descent_s + self.grip_s

    @property
    def fastest_m_s(self) -> float:
        return self.length_m / self.needed_s

    def as_dict(self) -> dict[str, float]:
        """Plain values."""
        keys = ("approach_s", "descent_s", "grip_s", "fastest_m_s")
        return {key: getattr(self, key) for key in keys}


class CycleEstimate:
    """For a job's config, its tool, the joints of its poses (6,), the belt's ``way`` (3,) in the base, and
    how long the gripper closes or opens (``gripper_s``); None: it is not known."""

    def __init__(
        self,
        config: BeltTrackingConfig,
        tool: ToolJoints,
        q_wait: Array,
        q_place: Array,
        way: Array,
        gripper_s: float | None = None,
    ) -> None:
        self._config, self._tool, self._way = config, tool, way / np.linalg.norm(way)
        self._q_wait, self._q_place = q_wait, q_place
        self._wait, self._place = tool.state(q_wait), tool.state(q_place)
        limits = config.limits
        self._limits, self._joint_speeds = pursuit_limits(limits), per_joint(limits.joint_speed_rad_s)
        self._axis = MotionLimits(limits.speed_m_s, limits.accel_m_s2, limits.jerk_m_s3)
        self._gripper_s = config.grip_timeout_s / 3.0 if gripper_s is None else gripper_s
        self._up = np.array([0.0, 0.0, config.down_m, 0.0])  # from the grip
        self._over_place = np.array([0.0, 0.0, config.above_m, 0.0])
        self._blend = blend_for(config, self._limits)

    def grip_point(self, along_m: float) -> Array:
        """Where an item of the least height is gripped (4,), at ``along_m`` (dot(p, dir)).

        Across the belt it is as far as the waiting pose.
        """
        z = self._config.belt_z_m + self._config.items.min_height_m + self._config.grip_m
        flat = self._way[:2]
        length = float(np.linalg.norm(flat))
        along = (along_m - self._way[2] * z) / length
        across = np.array([-flat[1], flat[0]]) / length
        xy = along * flat / length + float(across @ self._wait.p[:2]) * across
        return np.array([*xy, z, 0.0])

    def unreachable(self, guard: MotionGuard) -> list[str]:
        """One sentence for each end of the zone, and each pose, that ``guard`` or the arm forbids."""
        found = []
        zone, places = self._config.zone, Places(self._config, self._tool, self._q_place)
        for key, along in (("min_m", zone.min_m), ("max_m", zone.max_m)):
            p = self.grip_point(along)
            goals = [("above an item", p + self._up), ("at an item", p)]
            if places.is_grid:  # an item is lifted so high before it is carried over others
                high = np.array([*p[:2], max(places.top_level_m, p[2] + self._up[2]), p[3]])
                goals.append(("as high as above_m over the grid", high))
            for where, goal in goals:
                if why := self._forbidden(guard, goal):
                    found.append(
                        f"zone.{key} = {along:g} m cannot be worked in, {where}: {why}; shorten the zone"
                    )
                    break
        for key, q in (("wait_pose", self._q_wait), ("place_pose", self._q_place)):
            try:
                guard.check_joints(q)
            except CellError as exc:
                found.append(f"{key}: {exc.detail}; teach it elsewhere")
        if not found and (unusable := places.unreachable(guard)) is not None:
            other = "place_grid" if self._config.place_grid else "above_m"
            found.append(f"place_pose: {unusable}; teach it elsewhere, or change {other}")
        return found

    def _forbidden(self, guard: MotionGuard, goal: Array) -> str:
        try:
            guard.check_joints(self._joints_at(PursuitState.still(goal))[0])
        except CellError as exc:
            return exc.detail or str(exc)
        return ""

    def _joints_at(self, state: PursuitState) -> tuple[Array, Array]:
        """Joints and their speeds (6,) there, found on a straight way from the nearer pose."""
        q, start = self._q_wait, self._wait.p
        if np.linalg.norm(state.p - self._place.p) < np.linalg.norm(state.p - start):
            q, start = self._q_place, self._place.p
        return self._tool.joints(state, self._tool.walked(start, state.p, q))

    def too_fast_to_follow(self, speed_m_s: float) -> tuple[str, float, float] | None:
        """The joint that is most beyond its limit where an end of the zone is followed, its speed and the
        limit, rad/s; None where each keeps to its own."""
        zone, v = self._config.zone, np.array([*(speed_m_s * self._way), 0.0])
        states = (PursuitState(self.grip_point(at), v, np.zeros(4)) for at in (zone.min_m, zone.max_m))
        fastest = np.max([np.abs(self._joints_at(state)[1]) for state in states], axis=0)
        worst = int(np.argmax(fastest / self._joint_speeds))
        speed, limit = float(fastest[worst]), float(self._joint_speeds[worst])
        return (JOINTS[worst], speed, limit) if speed > limit else None

    def zone_times(self) -> ZoneTimes:
        """Of the waiting pose, the zone and the limits; the arm's ways are planned as the job does."""
        config, zone = self._config, self._config.zone
        classic = config.method == "classic"
        goals = (FixedPoint(self.grip_point(along)) for along in (zone.min_m, zone.max_m))
        if classic:  # the slower axis, as that method has it
            flat = [goal.p[:2] for goal in goals]
            farthest = float(slower_axis(np.array(flat), self._wait.p[:2], self._axis).max())
        else:
            farthest = max(self._way_to(0.0, self._wait, goal, self._up).t1 for goal in goals)
        follows = config.follow and not classic
        return ZoneTimes(
            approach_s=config.T1_s if classic else farthest,
            descent_s=float(rest_to_rest(np.array(config.down_m), self._axis)),
            grip_s=max(config.dwell_s, self._gripper_s) if follows else config.dwell_s,
            farthest_s=farthest,
            length_m=zone.max_m - zone.min_m,
        )

    def at_speed(self, speed_m_s: float) -> ExpectedCycle:
        """What a belt of this speed leaves."""
        config, zone = self._config, self._config.zone
        window = (zone.max_m - zone.min_m) / speed_m_s
        cycle, why = None, ""
        try:
            last = zone.max_m - speed_m_s * (config.dwell_s + self._gripper_s)
            middle = 0.5 * (zone.min_m + zone.max_m)
            cycle = self._cycle(speed_m_s, middle), self._cycle(speed_m_s, max(last, middle))
        except CellError as exc:
            why = self._why_not(speed_m_s, middle, exc)
        return ExpectedCycle(speed_m_s, window, speed_m_s * config.dwell_s, cycle, why)

    def _why_not(self, speed_m_s: float, along_m: float, exc: CellError) -> str:
        """Why an item cannot be met, and what would help: an item at rest tells whose fault it is.

        The place that ``exc`` names is not told where the belt is too fast: the item is metres on by then.
        """
        detail, limits = exc.detail or str(exc), self._config.limits
        if exc.name != "MOTION_UNREACHABLE":
            return detail
        try:
            self._cycle(0.0, along_m)
        except CellError as at_rest:
            if at_rest.name == exc.name:
                detail = at_rest.detail or str(at_rest)
            cure = "it is the same with a belt at rest: teach place_pose or wait_pose elsewhere"
            return f"no joints for {detail}; {cure}"
        cure = "raise limits of the job, or let the belt run slower"
        if speed_m_s >= limits.speed_m_s:
            return f"the belt is no slower than the tool may be, {limits.speed_m_s:g} m/s; {cure}"
        return (
            f"with {limits.speed_m_s:g} m/s and {limits.accel_m_s2:g} m/s^2 the tool comes up with it only "
            f"where the arm no longer reaches; {cure}"
        )

    def _cycle(self, speed_m_s: float, along_m: float) -> float:
        """From leaving the place to leaving it again, s, with contact at ``along_m``; of a grid with layers
        the slower of its lowest and its uppermost one."""
        grid = self._config.place_grid
        tops = [0.0] if grid is None or grid.layers == 1 else [0.0, grid.top_m]
        places = [FixedPoint(self._place.p + np.array([0.0, 0.0, top, 0.0])) for top in tops]
        return max(self._cycle_to(place, speed_m_s, along_m) for place in places)

    def _cycle_to(self, put: FixedPoint, speed_m_s: float, along_m: float) -> float:
        met = self.grip_point(along_m)
        clear = self._blend.clear_m
        left = np.array([0.0, 0.0, min(clear, self._config.above_m), 0.0])
        t, state, contact = 0.0, PursuitState.still(put.p + left), 1.0
        took = 0.0
        for _ in range(4):  # each from the state and the time to contact of the one before
            item = _Carried(met, speed_m_s * self._way, t + contact)
            begin = t
            leg = self._down_to(t, state, item, self._up)
            contact = leg.t1 - begin
            t = leg.t1 + max(self._config.dwell_s, self._gripper_s)
            leg = plan(t, leg.at(t), item, self._up, self._limits)
            t = _cleared(leg, clear)
            t, state = self._climbed(t, leg.at(t), put)
            leg = self._down_to(t, state, put, self._over_place)
            t = leg.t1 + self._gripper_s
            leg = plan(t, leg.at(t), put, self._over_place, self._limits)
            t = _cleared(leg, clear)
            state, took = leg.at(t), t - begin
        return took

    def _climbed(self, t: float, state: PursuitState, put: FixedPoint) -> tuple[float, PursuitState]:
        """When and how the tool is so high that it crosses a grid above what lies there."""
        high = float(put.p[2]) + self._config.items.max_height_m
        if self._config.place_grid is None or state.p[2] >= high:
            return t, state
        level = FixedPoint(np.array([*state.p[:2], put.p[2] + self._over_place[2], state.p[3]]))
        leg = self._way_to(t, state, level, np.zeros(4))
        t = _cleared(leg, high - float(state.p[2]))
        return t, leg.at(t)

    def _down_to(self, t: float, state: PursuitState, origin: Origin, up: Array) -> Leg:
        """The way to ``up`` (4,) over ``origin`` and, with a blend, down to it."""
        level = self._way_to(t, state, origin, up)
        turn = max(level.t1 - self._blend.lead_s, t)
        return plan(turn, level.at(turn), origin, np.zeros(4), self._limits, apart=True)

    def _way_to(self, t: float, state: PursuitState, origin: Origin, offset: Array) -> Leg:
        """As fast as limits and joints let: the job's own rule."""
        leg, _ = within_joint_speed(
            lambda share: plan(t, state, origin, offset, self._limits.slower(share)),
            self._fastest,
            self._joint_speeds,
        )
        return leg

    def _fastest(self, leg: Leg) -> Array:
        """The highest speed of each joint on ``leg``, (6,) rad/s."""
        return self._tool.fastest(leg, self._joints_at(PursuitState.still(leg.at(leg.t0).p))[0])


def _cleared(leg: Leg, height_m: float) -> float:
    """When the tool has risen by so much on ``leg``, s."""
    foot = float(leg.at(leg.t0).p[2])
    times = np.linspace(leg.t0, leg.t1, 100)
    return next((float(t) for t in times if leg.at(float(t)).p[2] - foot >= height_m), leg.t1)


def slides(dwell_s: float, speeds_m_s: Sequence[float] = SPEEDS_M_S) -> list[tuple[float, float]]:
    """(speed, how far an item slides under a tool that stands for the dwell), from a belt that creeps on."""
    every = (round(SLOWEST_SHARE * speeds_m_s[0], 6), *speeds_m_s)
    return [(v, round(v * dwell_s, 9)) for v in every]
