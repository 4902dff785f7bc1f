"""Job ``belt-tracking``: pick items from a moving belt and put them down."""

import asyncio
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from scipy.spatial.transform import RigidTransform

from cell.devices import Speed
from cell.errors import InputError, error
from cell.formats.result import Envelope, read_as
from cell.motion import MotionLease
from cell.poses import Array, from_pose6
from cell.procedure import FinishRequested, Procedure, Run
from cell.run_values import RunValues
from procedures.arm_setup import arm_model, lease_settings
from procedures.belt.camera_to_belt import CameraToBelt
from procedures.belt.config import BeltTrackingConfig
from procedures.belt.contact_uncertainty import ContactBudget
from procedures.belt.item_bookkeeping import ItemBookkeeping
from procedures.belt.item_tracking import BeltWatch
from procedures.belt.items import Outcome
from procedures.belt.live import BeltLive
from procedures.belt.motion.arm_following import ArmFollowing
from procedures.belt.motion.grip_alarm import grip_alarm
from procedures.belt.motion.gripper_times import GripperTimes
from procedures.belt.motion.gripper_work import STUCK
from procedures.belt.motion.picker import Picker
from procedures.belt.motion.place_clear import PlaceClear, PlaceWaits
from procedures.belt.motion.places import Places
from procedures.belt.motion.tool_joints import ToolJoints
from procedures.belt.outcome import result_of
from procedures.belt.prediction_check import with_predictions
from procedures.belt.record import DATA_FILE, PickRecord, header_of
from procedures.belt.result import BeltTrackingResult
from procedures.belt.states import CHECKPOINTS, PICKING, PickState
from procedures.kinematics_in_use import require_same_model

S = PickState
CAMERA = "fixed_camera"
LOOK_S = 0.05  # between looks at a belt that stands
HELD_S = 0.5  # age of what the gripper says
UPRIGHT_RAD = 0.02  # that the tool may lean at the poses
LOOK_M = 0.01  # between looks at the place on the way down to it, after an interruption
RISE_M_S = 0.25  # from anywhere in the zone, after an interruption: at full speed a joint may turn too fast


class BeltTracking(Procedure):
    """Detect, follow, grip, place; every item's life is kept."""

    name: ClassVar[str] = "belt-tracking"
    number: ClassVar[int] = 7
    kind: ClassVar[str] = "belt-tracking"
    Config = BeltTrackingConfig
    State = PickState
    TRANSITIONS: ClassVar[Mapping[Any, frozenset[Any]]] = PICKING
    CHECKPOINTS: ClassVar[frozenset[Any]] = CHECKPOINTS

    config: BeltTrackingConfig

    def uses(self) -> tuple[str, ...]:
        return self.config.roles()

    def check(self, values: RunValues) -> None:
        for key in ("wait_pose", "place_pose"):
            name = getattr(self.config, key)
            if name not in values.poses:
                known = ", ".join(values.poses) or "none"
                raise error("ARGUMENT_INVALID", f"{key} '{name}' is not in [poses]; there is {known}")
        belt_of(values)
        for name in [name for name in values.versions if name.startswith("belt.")]:
            require_same_model(values, name)
        CameraToBelt(values, self.config.belt_z_m, self.config.items)

    async def run(self, run: Run) -> None:
        await run.enter(S.PREPARE)
        picking = _Picking(self.config, run)
        started = run.clock.now()
        async with picking.record() as picking.watch.record:
            await self._watched(run, picking)
            duration_s = run.clock.now() - started
        await run.enter(S.REPORT)
        picked = result_of(
            picking.watch,
            picking.arm_following,
            picking.gripper_times,
            picking.place_waits,
            picking.places,
            self.config,
            run.values,
            duration_s,
        )
        run.result = picked
        if (path := run.folder / DATA_FILE).exists():
            try:
                run.result = await run.worker.call(with_predictions, picked, path)
            except InputError as exc:  # what was picked stays what it was
                run.note("solve", event="not solved", why=str(exc))

    async def _watched(self, run: Run, picking: "_Picking") -> None:
        with picking.watch:
            await run.take_step("prepare the camera", picking.look_for_items)
            try:
                try:
                    with suppress(FinishRequested):
                        await picking.bookkeeping.beside(picking.go())
                finally:
                    await asyncio.shield(picking.bookkeeping.close())
            finally:
                await asyncio.shield(picking.camera.set_items(None))

    async def dry_run(self, run: Run) -> dict[str, Any]:
        """The poses, and what the belt, the zone and the limits make of a pick; nothing moves."""
        picking = _Picking(self.config, run)
        return {"poses": picking.poses(), "note": "the way to an item is planned when it is seen"}

    @classmethod
    def solve_again(cls, path: Path, info: Mapping[str, Any], recorded: Mapping[str, Any]) -> Envelope:
        """What was picked is in journal and ledger; solved is where items were predicted to be."""
        return with_predictions(read_as(BeltTrackingResult, recorded), path)


def belt_of(values: RunValues) -> Mapping[str, Any]:
    """``m_per_count`` and ``dir`` of the belt; ``BELT_NOT_CALIBRATED`` when nothing says them."""
    if values.belt is None:
        raise error("BELT_NOT_CALIBRATED", "there is neither a committed nor a configured value")
    return values.belt


class _Picking:
    """Devices and values of one run."""

    def __init__(self, config: BeltTrackingConfig, run: Run) -> None:
        self.config, self.run, values = config, run, run.values
        self.arm, self.camera = run.arm(), run.camera(CAMERA)
        self.camera_to_belt = CameraToBelt(values, config.belt_z_m, config.items)
        self.watch = BeltWatch(run.encoder(), self.camera, self.camera_to_belt, belt_of(values), config)
        self.watch.learnt = BeltLive(run).look
        self.watch.tell = lambda event, **what: run.note("decision", event=event, **what)
        self.bookkeeping = ItemBookkeeping(run, self.watch, config.picks, config.failed_grips)
        self.q_wait: Array = np.array(values.poses[config.wait_pose])
        self.q_place: Array = np.array(values.poses[config.place_pose])
        self.model = arm_model(values)
        self.tool = ToolJoints(self.model, from_pose6(values.tool["T_flange_tool"]), self.q_wait)
        self.guard = lease_settings(values)[0]
        self.gripper_times = GripperTimes(config.grip_timeout_s, run.grips_confirmed())
        inputs = run.inputs("place_inputs") if config.place_clear else None
        self.place_clear, self.place_waits = PlaceClear(inputs, config.place_clear), PlaceWaits(run.clock)
        self.places = Places(config, self.tool, self.q_place, lambda number: run.publish(next_place=number))
        # The classic method predicts no uncertainty.
        budget = None if config.method == "classic" else ContactBudget(values, self.camera_to_belt)
        self.arm_following = ArmFollowing(
            self.arm.expected_lag_s, config.following_limit_m, self.guard, budget
        )
        for key, q in (("wait_pose", self.q_wait), ("place_pose", self.q_place)):
            lean = self.tool.lean(q)
            if lean > UPRIGHT_RAD:
                raise error(
                    "ARGUMENT_INVALID", f"{key}: the tool leans by {lean:.3f} rad; it must point down"
                )

    def record(self) -> PickRecord:
        """Keeps what the run sees and does."""
        run, encoder = self.run, self.run.encoder()
        wait = self.tool.state(self.q_wait)
        header = header_of(self.config, belt_of(run.values), encoder, wait)
        return PickRecord(run.folder, run.clock, encoder, header)

    def poses(self) -> list[dict[str, Any]]:
        """Waiting pose and place, as a plan lists them."""
        named = {"wait": self.q_wait, "place": self.q_place}
        return [
            {"index": k, "name": name, "q": q.tolist(), "tool": self.tool.state(q).p[:3].tolist()}
            for k, (name, q) in enumerate(named.items())
        ]

    async def go(self) -> None:
        """Lease after lease: a belt that stands is waited for without one."""
        run = self.run
        await run.take_step("look at the gripper", self._require_empty)
        await self._look_at_grid()
        while True:
            async with run.motion() as lease:
                await run.take_step("open the gripper", self._open_gripper)
                if not await run.take_step("picking", partial(self._pick_from_rest, lease), measures=False):
                    return
            await self._wait_for_belt()

    async def _look_at_grid(self) -> None:
        """``ARGUMENT_INVALID`` when a place is out of reach; a person says whether the places are empty."""
        grid, places = self.config.place_grid, self.places
        if grid is None:
            return
        if (why := await asyncio.to_thread(places.unreachable, self.guard)) is not None:
            raise error("ARGUMENT_INVALID", f"place_grid: {why}")
        if grid.ask_empty:
            which = f"places {places.number} to {len(places)}"
            await self.run.ask(f"Items will be put into {which}. See that these are empty, then confirm.")

    async def look_for_items(self) -> None:
        """From now on the camera does."""
        await self.camera.set_items(self.camera_to_belt.spec())

    async def _require_empty(self) -> None:
        gripper = self.run.gripper()
        if gripper.holding(HELD_S):
            raise error("GRIPPER_HOLDS", gripper.name)

    async def _open_gripper(self) -> None:
        if not await self.run.gripper().release(self.config.grip_timeout_s):
            raise error("GRIPPER_STUCK", STUCK)

    async def _pick_from_rest(self, lease: MotionLease) -> bool:
        """From wherever the arm stands; see :meth:`_pick`."""
        run = self.run
        await run.enter(S.TO_WAIT)
        if run.steps_taken.taken_again:
            await self._clear_hands(lease)
        await lease.move_joints(self.q_wait)
        await run.enter(S.READY)
        if self._ends_full:
            return False
        return await self._pick(lease)

    @property
    def _ends_full(self) -> bool:
        """Whether the grid is full and the job ends with it; what the gripper holds stays there, as after a
        finish."""
        grid = self.config.place_grid
        return grid is not None and grid.when_full == "end" and self.places.full

    async def _clear_hands(self, lease: MotionLease) -> None:
        """After an interruption: straight up first, and what the gripper holds is put down at the place.

        Fingers that closed on nothing are opened as well, or they would be closed when they meet an item.
        """
        if self.bookkeeping.was_let_go:  # it is in its place already
            await self._open_gripper()
        here = self.arm.state.latest(0.1).value
        level = max(self.tool.state(self.q_wait).p[2], self.places.level_m)
        if (rise := float(level - self.tool.state(here.q).p[2])) > 0.0:
            up = RigidTransform.from_translation([0.0, 0.0, rise]) * here.T_base_flange
            await lease.move_linear(up, self._slow())
        if not self.run.gripper().holding(HELD_S):
            await self._open_gripper()
            self.bookkeeping.end_carried(self.bookkeeping.if_empty)
            return
        if self._ends_full:
            return  # there is no place for it
        if self.places.full:
            await self._renew_grid()
        above = await self._into_place(lease)
        self.places.take()
        self.bookkeeping.if_empty = Outcome.PICKED
        await self._open_gripper()
        self.bookkeeping.end_carried(Outcome.PICKED)
        self.run.steps_taken.part_done()
        await lease.move_linear(above, self._slow())  # what lies beside is not swept away

    def _slow(self) -> Speed:
        speed = lease_settings(self.run.values)[2]
        return replace(speed, tcp_m_s=min(speed.tcp_m_s, RISE_M_S))

    async def _into_place(self, lease: MotionLease) -> RigidTransform:
        """With what the gripper holds: over the place, and straight down when it is clear; the flange above
        it. The arm stops to look at the place again and again, down to where its sensor may see the tool."""
        flanges = self.tool.flanges(self.places.looks_down(LOOK_M))
        above, *looks, down = (RigidTransform.from_matrix(T) for T in flanges)
        await lease.move_joints(self.places.joints_over())
        taken = self.place_clear.obstacle() is not None
        while True:
            while taken:
                await self._until_place_is_clear()
                await self.run.enter(S.TO_WAIT)
                taken = self.place_clear.obstacle() is not None
            for look in looks:
                await lease.move_linear(look, self._slow())
                if taken := self.place_clear.taken_on_the_way_down():
                    break
            else:
                await lease.move_linear(down, self._slow())
                return above
            await lease.move_linear(above, self._slow())

    async def _until_place_is_clear(self) -> None:
        """At rest with an item: something outside has to clear the place, so the job is suspended."""
        run, why = self.run, self.place_clear.last_obstacle
        self.place_waits.begin()
        try:
            while why is not None:
                await run.enter(S.WAIT_PLACE, why)
                run.suspend(f"with an item above the place: {why}")
                run.publish(place_waits=self.place_waits.count)
                await run.clock.sleep(LOOK_S)
                while self.place_clear.obstacle() is not None and not run.wants_rest:
                    await run.clock.sleep(LOOK_S)
                run.unsuspend()
                why = self.place_clear.obstacle()
            await run.enter(S.WAIT_PLACE, "the place is clear again")
        finally:
            self.place_waits.end()

    async def _pick(self, lease: MotionLease) -> bool:
        """Stream until the belt stands (True) or enough is picked (False); pauses end in READY."""
        run = self.run
        wait = self.tool.state(self.q_wait)
        picker = Picker(
            run,
            self.config,
            self.watch,
            self.bookkeeping,
            self.arm_following,
            self.gripper_times,
            self.tool,
            self.guard,
            wait,
            self.places,
            self.place_clear,
        )
        while not picker.enough:
            await self._until_picks_are_wanted()
            await lease.stream(picker.pieces(self.arm.state.latest(0.1).value.q))
            while self.bookkeeping.carried is not None:  # above a place that is not clear
                await self._until_place_is_clear()
                await lease.stream(picker.pieces(self.arm.state.latest(0.1).value.q))
            if self.bookkeeping.grips_fail:
                await run.enter(S.READY)
                await self._alarm()
            elif self.places.full:
                if self._ends_full or picker.enough:
                    return False
                await run.enter(S.READY)
                await self._renew_grid()
            elif picker.standing:
                return True
            await run.enter(S.READY)
        return False

    async def _renew_grid(self) -> None:
        """All places are filled: somebody puts empty ones there, and the arm rests."""
        await self.run.ask(
            f"All {len(self.places)} places are filled. See that all of them are empty again, then confirm."
        )
        self.places.renew()
        self.run.note("decision", event="places are empty again", places=len(self.places))

    async def _alarm(self) -> None:
        """Grip after grip took nothing: somebody has to look, and the arm rests."""
        failed = self.bookkeeping.failed_in_a_row
        alarm = error("GRIPS_FAILED", grip_alarm(failed, self.arm_following, self.gripper_times))
        if self.config.on_failed_grips == "end":
            raise alarm
        self.run.note("error", **alarm.as_dict())
        await self.run.ask(f"{failed} grips in a row took nothing. Look at gripper and items, then confirm.")
        self.bookkeeping.failed_in_a_row = 0

    async def _until_picks_are_wanted(self) -> None:
        """Somebody outside wants no new picks for now: suspended, at rest above the belt."""
        run = self.run
        while not run.work_wanted:
            run.suspend("no new picks are wanted")
            while not run.work_wanted and not run.wants_rest:
                await run.clock.sleep(LOOK_S)
            run.unsuspend()
            await run.enter(S.READY)

    async def _wait_for_belt(self) -> None:
        """The belt stands or runs backward: something outside, so the job is suspended, at rest."""
        run, config = self.run, self.config
        while True:
            await run.enter(S.STANDING, f"belt speed {self.watch.speed():.4f} m/s")
            if self.watch.speed() >= config.standing_m_s:  # also when it went on while the lease ended
                return
            run.suspend("the belt stands or runs backward")
            while self.watch.speed() < config.standing_m_s and not run.wants_rest:
                await run.clock.sleep(LOOK_S)
            run.unsuspend()
