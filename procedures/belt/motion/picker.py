"""One stream of set-points from item to item: approach, descend, grip, lift, place, and back.

The picker decides every 20 ms, from what is known then, where the tool goes next; each plan begins in the
state that the one before is in, so a forecast that changes bends the path and never breaks it.
"""

from collections.abc import AsyncIterator, Callable, Coroutine
from typing import Any

import numpy as np

from calibration.belt.arm_time import MotionLimits, rest_to_rest
from calibration.belt.pursuit import FixedPoint, Leg, PursuitState, Ride
from cell.devices import TrajectoryPiece
from cell.errors import CellError, error, present
from cell.guard import MotionGuard
from cell.poses import Array
from cell.procedure import Run
from procedures.belt.config import BeltTrackingConfig
from procedures.belt.item_bookkeeping import ItemBookkeeping
from procedures.belt.item_tracking import BeltWatch
from procedures.belt.items import CONTACT, Item, Outcome
from procedures.belt.motion.arm_following import ArmFollowing
from procedures.belt.motion.blend import blend_for
from procedures.belt.motion.gripper_times import GripperTimes
from procedures.belt.motion.gripper_work import GripperWork
from procedures.belt.motion.item_selection import ItemSelection
from procedures.belt.motion.meeting import Aim, strategy
from procedures.belt.motion.place_clear import PlaceClear
from procedures.belt.motion.places import Places
from procedures.belt.motion.putting_down import Put, PuttingDown
from procedures.belt.motion.tool_joints import ToolJoints, on_piece
from procedures.belt.motion.tool_path import AHEAD_S, LEAD_S, STEP_S, ToolPath, pursuit_limits
from procedures.belt.states import PickState as S

LEARN_S = 0.04  # between looks at what has come in, but for the last of the way to an item
CLOSE = frozenset({S.DESCEND, S.GRIP})
MET_M, MET_M_S, MET_RAD = 0.0003, 0.02, 0.02  # from rest on an item
DOUBT_S, DOUBT_M = 0.15, 0.0003  # a belt that may be so far off so soon is waited for just above its item
RISE_S = 0.08  # until fingers that leave are clear of the item
REFUSED_S = 0.2  # an item out of reach is not tried again for so long: the arm goes on, and so does the belt


class Picker:
    """Streams until something asks for rest; what is carried then is put down in the next stream."""

    def __init__(
        self,
        run: Run,
        config: BeltTrackingConfig,
        watch: BeltWatch,
        bookkeeping: ItemBookkeeping,
        following: ArmFollowing,
        gripper_times: GripperTimes,
        tool: ToolJoints,
        guard: MotionGuard,
        wait: PursuitState,
        places: Places,
        clear: PlaceClear,
    ) -> None:
        self._run, self._config, self._watch = run, config, watch
        self._bookkeeping, self._tool = bookkeeping, tool
        self._wait, self._places = FixedPoint(wait.p), places
        limits = config.limits
        axis = MotionLimits(limits.speed_m_s, limits.accel_m_s2, limits.jerk_m_s3)
        self._descent_s = float(rest_to_rest(np.array(config.down_m), axis))
        self._above = np.array([0.0, 0.0, config.above_m, 0.0])  # of an item's upper face, and of the place
        self._at_grip = np.array([0.0, 0.0, config.grip_m, 0.0])
        classic = config.method == "classic"
        self._blend = blend_for(config, pursuit_limits(limits))
        self._aim: Aim | None = None
        self._meets_only = classic or not config.follow
        self._strategy = strategy(config, watch, wait.p[:3], self._descent_s)
        self._gripper = GripperWork(run.gripper(), run.clock, config.grip_timeout_s, gripper_times)
        self._arm, self._following = run.arm(), following
        self._held = self._is_cautious = False
        self._item: Item | None = None
        self._awaited: Item | None = None  # on its way to the zone
        self._t_contact, self._foot_m, self._tries = 0.0, 0.0, 0
        self._phase: Callable[[float], Coroutine[Any, Any, bool]] = self._ready
        self._path = ToolPath(tool, limits, guard, wait)
        self._putting = PuttingDown(config, self._path, self._gripper, places, clear, self._wait)
        self._choice = ItemSelection(config, watch, tool, float(wait.p[3]), self._descent_s, gripper_times)
        self._learnt, self.standing = -np.inf, False
        self._standing_since: float | None = None

    async def pieces(self, q: Array) -> AsyncIterator[TrajectoryPiece]:
        """Set-points from rest at ``q`` (6,) on, until one of these reasons for rest."""
        clock = self._run.clock
        t = clock.now() + (LEAD_S + self._following.delay_s)
        self._path.start(t, q, self._wait)
        self._following.lag.begin(clock.now(), q)
        self._phase, self.standing, self._standing_since = self._ready, False, None
        here = q, np.zeros(6)
        sent: TrajectoryPiece | None = None
        self._bookkeeping.streaming = True
        try:
            if (carried := self._bookkeeping.take_up()) is not None:
                self._item, self._held = carried, True
                await self._begin_putting(t)
            while True:
                await self._learn()
                self._path.catch_up(t, here)
                if not await self._phase(t):
                    return
                piece = self._path.piece(t, here)
                self._keep(t)
                # A piece that is over would only end the one in use.
                if clock.now() < t - self._following.delay_s + AHEAD_S:
                    yield self._following.ahead(piece)
                    sent = piece
                await clock.sleep(max(t + STEP_S - (LEAD_S + self._following.delay_s) - clock.now(), 0.0))
                t = max(t + STEP_S, clock.now() + (LEAD_S + self._following.delay_s))
                if sent is None or t > sent.t1:  # the arm is braked on its own where its set-points end
                    raise error("MOTION_WATCHDOG", "the PC paused for longer than the arm has set-points")
                here = on_piece(sent, t)  # where the arm is sent then, also when the plan changes
        finally:
            await self._gripper.end()
            if self._item is not None and self._item.touched:  # in the gripper, or where the arm stopped
                self._bookkeeping.carry(self._item, self._if_empty)
                self._item = None
            self._bookkeeping.streaming = False

    @property
    def _if_empty(self) -> Outcome:
        """What became of the item in hand, if the gripper turns out to hold nothing where the arm stopped."""
        if self._phase == self._put_down and self._putting.lets_go:
            return Outcome.PICKED
        return Outcome.LOST if self._held else Outcome.GRIP_FAILED

    def _keep(self, t: float) -> None:
        """This set-point, for whoever looks at the run later."""
        if (record := self._watch.record) is not None:
            number = 0 if self._item is None else self._item.number
            record.goes(t, self._path.at(t), self._watch.speed(), number)

    # -- what is known

    async def _learn(self) -> None:
        now = self._run.clock.now()
        if (sample := self._arm.state.last()) is not None:
            wanted = self._following.lag.look(sample.t, sample.value.q)
            if self._run.state is S.GRIP and wanted is not None:
                self._following.look(sample.t, *self._tool.points(np.stack([sample.value.q, wanted])))
        if self._run.state not in CLOSE and now - self._learnt < LEARN_S - 0.5 * STEP_S:
            return
        self._learnt = now
        self._bookkeeping.look(self._item)
        self._run.live.update(self._following.live())
        self._judge_belt(now)

    def _judge_belt(self, now: float) -> None:
        """A belt that stands for long, or runs backward, is waited for at rest."""
        config = self._config
        if self._watch.speed() >= config.standing_m_s:
            self._standing_since = None
            return
        self._standing_since = now if self._standing_since is None else self._standing_since
        backward = self._watch.speed() <= -config.standing_m_s
        if backward or now - self._standing_since >= config.standing_s:
            self.standing = True

    @property
    def enough(self) -> bool:
        """Whether as many items were picked as were wanted."""
        return 0 < self._config.picks <= self._watch.queue.counts[Outcome.PICKED]

    @property
    def _in_hand(self) -> Item:
        """The item that the phases from the approach to the grip are about."""
        return present(self._item, "item in hand")

    @property
    def _agreed(self) -> Aim:
        """The contact that was agreed on with a tool that does not follow."""
        return present(self._aim, "agreed contact")

    @property
    def _rest_wanted(self) -> bool:
        wanted = self._run.wants_rest or not self._run.work_wanted or self.standing or self.enough
        return wanted or self._bookkeeping.grips_fail or self._places.full

    # -- phases: each decides about the leg from ``t`` on; False ends the stream

    async def _ready(self, t: float) -> bool:
        """At rest above the belt, or on the way there: whoever comes first is next."""
        if self._rest_wanted:
            if self._run.state is S.WAIT:
                await self._run.enter(S.RETURN, "rest is wanted")
            self._path.go(t, self._wait, np.zeros(4))
            return t < self._path.t1
        if self._meets_only:
            return await self._agree(t)
        for item, ride in self._choice.reachable(t, self._path, self._above):
            tried = self._tried(t, item, ride)
            if tried is not None and self._choice.can_be_met(ride.track, tried[0].t1):
                self._path.take(tried)
                self._item = item
                item.note(t, "approach")
                await self._run.enter(S.APPROACH, f"item {item.number}")
                self._phase = self._approach
                return True
        await self._await_next(t)
        return True

    async def _await_next(self, t: float) -> None:
        """Above where the next item will come into the zone; without one, or where it cannot be gripped, at
        the waiting point."""
        for item, above in self._choice.coming(t):
            if self._awaited is item:
                self._path.go(t, above, self._above)
            elif (tried := self._tried(t, item, above)) is not None:
                self._awaited = item
                self._path.take(tried)
            else:
                continue
            if self._run.state is not S.WAIT:
                await self._run.enter(S.WAIT, f"item {item.number}")
            return
        self._awaited = None
        self._path.go(t, self._wait, np.zeros(4))

    def _tried(self, t: float, item: Item, origin: Ride | FixedPoint) -> tuple[Leg, float] | None:
        """The way above ``item`` at ``origin``, if guard and joints allow it and the grip at its end.

        An item that lies badly is nothing to end the job for; its life says why it was let pass.
        """
        if t < item.refused_until:
            return None
        try:
            tried = self._path.tried(t, origin, self._above)
            contact = tried[0].t1 + self._descent_s
            grips = [origin.at(at) for at in (contact, contact + self._config.dwell_s)]
            self._path.check(tried, [state + PursuitState.still(self._at_grip) for state in grips])
        except CellError as why:
            if not item.refused_until:
                item.note(t, f"out of reach: {why}")
            item.refused_until = t + REFUSED_S
            return None
        return tried

    async def _approach(self, t: float) -> bool:
        ride = self._ride()
        if ride is None or self.standing:
            return await self._give_up(t)
        self._path.go(t, ride, self._above)
        if not self._choice.can_be_met(ride.track, self._path.t1):
            return await self._give_up(t)
        turns = self._path.t1 - t <= self._blend.lead_s
        if turns and self._choice.has_come_in(ride.track, t + self._descent_s):
            self._path.at_full_speed()
            await self._run.enter(S.DESCEND)
            self._following.contacts.begin()
            self._is_cautious = self._watch.doubt(DOUBT_S) > DOUBT_M
            self._phase = self._descend
        return True

    async def _descend(self, t: float) -> bool:
        ride = self._ride()
        if ride is None or self.standing:
            return await self._give_up(t)
        self._path.descend(t, ride, self._at_grip, self._is_cautious)
        self._following.contacts.expect(t, *self._path.touches(self._at_grip), ride.track)
        if not self._choice.inside(ride.track, self._path.t1, self._path.t1 + self._config.dwell_s):
            return await self._give_up(t)
        if self._meets(t, ride):
            await self._close(t)
        return True

    async def _close(self, t: float) -> None:
        """In contact."""
        self._in_hand.note(t, CONTACT)
        self._t_contact, self._tries, self._held = t, 1, False
        await self._run.enter(S.GRIP)
        self._gripper.begin_grip(t - LEAD_S)
        self._phase = self._grip

    # -- phases of a tool that meets an item and does not follow it

    async def _agree(self, t: float) -> bool:
        """At rest at the waiting point: agree on a contact that the arm can keep."""
        self._path.go(t, self._wait, np.zeros(4))
        if self._path.t1 > t:
            return True
        if self._run.state is not S.WAIT:
            await self._run.enter(S.WAIT)
        for item in self._watch.queue.waiting(self._config.min_sightings):
            aim = self._strategy.meet(item, t)
            while aim is not None:
                if (tried := self._tried(t, item, self._aimed(item, aim))) is None:
                    break
                late = tried[0].t1 + self._descent_s - aim.contact
                if late <= STEP_S:
                    self._path.take(tried)
                    self._item, self._aim, self._phase = item, aim, self._go_above
                    item.note(t, "approach")
                    await self._run.enter(S.APPROACH, f"item {item.number}")
                    return True
                aim = self._strategy.later(item, aim, late)
        return True

    async def _go_above(self, t: float) -> bool:
        """Above the agreed place, and there until it is time to go down."""
        if (place := self._aim_improved(t)) is None:
            return await self._give_up(t)
        self._path.go(t, place, self._above)
        if t >= self._agreed.contact - self._descent_s - 0.5 * STEP_S:
            self._path.at_full_speed()
            await self._run.enter(S.DESCEND)
            self._following.contacts.begin()
            self._phase = self._go_down
        return True

    async def _go_down(self, t: float) -> bool:
        if (place := self._aim_improved(t)) is None:
            return await self._give_up(t)
        self._path.go(t, place, self._at_grip)
        track = self._watch.track(self._in_hand)
        self._following.contacts.expect(t, *self._path.touches(self._at_grip), track)
        if self._path.t1 - t <= 0.5 * STEP_S:
            await self._close(t)
        return True

    def _aim_improved(self, t: float) -> FixedPoint | None:
        """Where the item in hand will be at the agreed contact; None when it cannot be met there any more."""
        item, aim = self._in_hand, self._agreed
        self._strategy.improve(item, aim, t)
        place = self._aimed(item, aim)
        lost = self.standing or self._watch.track(item) is None
        return None if lost or not self._choice.holds(place.p[:3]) else place

    def _aimed(self, item: Item, aim: Aim) -> FixedPoint:
        return FixedPoint(np.array([*aim.xy, aim.height, self._choice.yaw(item)]))

    def _meets(self, t: float, ride: Ride) -> bool:
        """Whether the tool is on the item and moves with it: a forecast that shakes is never met exactly."""
        gap = self._path.at(t) - ride.at(t)
        off = float(np.linalg.norm(gap.p[:3] - self._at_grip[:3]))
        met = off < MET_M and abs(gap.p[3]) < MET_RAD
        return met and float(np.linalg.norm(gap.v[:3])) < MET_M_S

    async def _grip(self, t: float) -> bool:
        """Move with the item until it is held, at least for the dwell and at most to the edge of the zone."""
        held, out = self._gripper.answer(), self._follow(t)
        if not out and (held is None or t < self._t_contact + self._config.dwell_s):
            return True
        held = bool(held)
        if not held and not out and self._tries < self._config.grip_tries and not self._meets_only:
            self._in_hand.note(t, "not held")
            self._gripper.begin_release(t - LEAD_S)
            self._phase = self._grip_again
            return True
        return await self._end_grip(t, held)

    async def _end_grip(self, t: float, held: bool) -> bool:
        """Up, with the item or without."""
        self._following.contacts.end(self._in_hand, self._watch, self._following.level)
        self._in_hand.note(t, "gripped" if held else "grip failed")
        self._held = held
        await self._run.enter(S.LIFT)
        if not held:
            self._gripper.begin_release(t - LEAD_S)
            await self._end_item(Outcome.GRIP_FAILED)
        self._foot_m = float(self._path.at(t).p[2])
        self._path.rise(t, self._above)
        self._phase = self._lift
        return True

    async def _grip_again(self, t: float) -> bool:
        """The item slid when the fingers closed, as the belt changed just then: open them, and once more."""
        if self._follow(t):
            return await self._end_grip(t, False)
        if self._gripper.opened():
            self._tries += 1
            self._gripper.begin_grip(t - LEAD_S)
            self._phase = self._grip
        return True

    def _follow(self, t: float) -> bool:
        """On with the item in the grip; whether it is about to leave the zone."""
        if self._meets_only or (ride := self._ride()) is None:
            return False
        self._path.go(t, ride, self._at_grip, apart=True)
        return not self._choice.inside(ride.track, t, t + RISE_S)

    async def _lift(self, t: float) -> bool:
        """Straight up, seen from the belt, until what lies beside is cleared."""
        if not self._path.has_risen(t, self._foot_m, self._blend):
            return True
        if self._held:
            if self._places.is_grid:
                self._in_hand.note(t, self._places.words(self._places.number))
            await self._begin_putting(t)
        elif self._gripper.opened():
            await self._run.enter(S.RETURN)
            self._phase = self._ready
        return True

    async def _begin_putting(self, t: float) -> None:
        await self._run.enter(S.PLACE)
        self._putting.begin(t)
        self._phase = self._put_down

    async def _put_down(self, t: float) -> bool:
        """To the place and away from it; a stream ends above a place that is not clear."""
        match self._putting.step(t):
            case Put.BLOCKED:
                return False
            case Put.EMPTY:
                await self._end_item(Outcome.LOST)
            case Put.OPENED if self._item is not None:
                await self._end_item(Outcome.PICKED)
                self._run.steps_taken.part_done()
            case Put.LEFT:
                await self._run.enter(S.RETURN)
                self._path.begin(t, self._wait, np.zeros(4))
                self._phase = self._ready
        return True

    # -- steps of the phases

    def _ride(self) -> Ride | None:
        """The item in hand, as it is predicted now."""
        return None if self._item is None else self._choice.ride(self._item)

    async def _give_up(self, t: float) -> bool:
        """This item cannot be met any more; it ends when it leaves the zone. Who is low rises first."""
        if self._item is not None:
            self._item.note(t, "given up")
            self._item = None
        await self._run.enter(S.RETURN)
        if self._phase in (self._descend, self._go_down):
            self._foot_m = float(self._path.at(t).p[2])
            self._path.rise(t, self._above)
            self._phase = self._rise
        else:
            self._phase = self._ready
            self._path.go(t, self._wait, np.zeros(4))
        return True

    async def _rise(self, t: float) -> bool:
        """Straight up beside an item that was given up."""
        if self._path.has_risen(t, self._foot_m, self._blend):
            self._phase = self._ready
            self._path.begin(t, self._wait, np.zeros(4))
        return True

    async def _end_item(self, outcome: Outcome) -> None:
        item, self._item = self._item, None
        if item is not None:
            self._bookkeeping.end(item, outcome)
