"""One run from the first look to the last retreat; a step can be taken again from wherever the arm stands."""

import asyncio
import json
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from cell.devices import ArmState, Speed
from cell.errors import error, present
from cell.formats.capture import Camera
from cell.motion import MotionLease
from cell.poses import from_pose6, to_pose6
from cell.procedure import FinishRequested, Run
from cell.store.files import write_atomic
from procedures.arm_setup import arm_robot, lease_settings
from procedures.hand_eye_in_use import HAND_EYE, arm_rms_m, solved_lens
from procedures.slot.config import SlotInsertionConfig
from procedures.slot.data import DATA_FILE, HandEyeKnown, InsertionOutcome, LookTaken, SlotData
from procedures.slot.judging import measured_in_run, refusal
from procedures.slot.places import SlotPlaces
from procedures.slot.plan import Route, plan_route
from procedures.slot.result import SlotBudget
from procedures.slot.seeing import inside
from procedures.slot.states import PartState
from procedures.slot.states import State as S
from procedures.slot.stations import Stations, along
from procedures.words import mm

_EMPTY, _FULL = 0.5, 0.1  # of a slot's depth: deeper than this it is empty, shallower it is occupied
_MEASURED_SIGMA = (0.0005, 0.0005, 0.002)  # of a slot that a coarse look has found, m


class InsertionRun:
    """The data and the devices of one run, and the steps that work on them."""

    def __init__(self, config: SlotInsertionConfig, run: Run) -> None:
        self.config, self.run = config, run
        self.stations = Stations.of(config, run.values)
        self.camera, self.arm = run.camera("flange_camera"), run.arm()
        self.speed = lease_settings(run.values)[2]
        self.places = SlotPlaces(config, run, self.speed, self.note_part)
        self.data = SlotData(
            job=config.model_dump(mode="json"),
            robot=arm_robot(run.values),
            arm_rms_m=arm_rms_m(run.values),
            hand_eye=HandEyeKnown(
                T_flange_camera=_six(self.stations.T_flange_camera),
                cov=run.values.uncertainty[HAND_EYE]["cov"],
                budget=run.values.uncertainty[HAND_EYE].get("budget", []),
            ),
            T_flange_part=_six(self.stations.T_flange_part),
        )
        self.part: list[PartState] = [PartState.NONE]
        self.reasons: list[str] = []
        self.travel_m: float | None = None
        self.force_n: float | None = None
        self._looks = 0

    async def plan(self, T_base_slot: list[float] | None = None) -> Route:
        """The stations of the slot where it is, or where the rack's model has it; nothing moves."""
        q = [float(v) for v in (await self.run.arm_state()).q]
        job = self.data.job
        return await self.run.worker.call(plan_route, self.run.values, job, T_base_slot, q)

    async def take_all(self) -> None:
        """The whole of it. What went wrong with the part is in the result, what kept it from being tried is
        an error."""
        run, action = self.run, self.config.action
        await run.enter(S.PREPARE)
        route = await self.plan()
        run.note("decision", event="plan", plan=route.listing)
        await asyncio.to_thread(self.write)
        try:
            async with run.motion() as lease:
                await self._leave_rack(lease)
                done = True
                if action != "insert":
                    done = await self._pull(lease)
                if action != "pull" and done:
                    await self._insert(lease)
        except FinishRequested:
            self.reasons.append(
                "finished: before the part was where it belongs, because somebody asked for it"
            )

    def note_part(self, state: PartState, why: str = "") -> None:
        """The part's next state; ``why`` where that is not as it should be."""
        self.part.append(state)
        self.run.note("decision", event="part", part=state.value, why=why)
        if why:
            self.reasons.append(why)

    async def _leave_rack(self, lease: MotionLease) -> None:
        """Back along the slots, when an earlier run was ended there; ``ARM_IN_RACK`` when a force is in the
        way. Any other way would break something."""
        run, clear = self.run, self.config.insertion.clear_m
        rack = from_pose6(self.config.rack.T_base_rack)
        here = (await run.arm_state()).T_base_flange
        if not self.stations.among_slots(here):
            return
        depth = self.stations.depth(rack, here)
        out = rack * along(-clear - depth) * rack.inv() * here

        async def back() -> bool:
            await run.enter(S.RETREAT, f"the front of the gripper is {mm(depth, 1)} in the rack")
            force = self.config.insertion.max_force_n
            return await lease.guarded_move(out, force, clear + depth, self._slow())

        if await run.take_step("leave the rack", back, measures=False):
            raise error("ARM_IN_RACK", "a force is in the way back along its slots")

    # -- insertion and extraction

    async def _insert(self, lease: MotionLease) -> None:
        """Fetch a part or take the one that is held, measure, and put it in."""
        run = self.run
        await self.places.fetch(lease)
        route, T_slot, budget = await self._measure(lease, "opening")
        why = None if budget is None else refusal(SlotBudget.model_validate(budget))
        if why is not None:
            run.note("decision", event="refused", why=why)
            self.reasons.append(why)
            return
        if not await self.places.still_held(S.MEASURE):
            return
        insertion = self.config.insertion
        near = self.stations.front_at(T_slot, -insertion.near_m)

        async def align() -> None:
            await run.enter(S.ALIGN)
            await lease.move_joints(np.array(route.before))
            await lease.move_linear(near)

        await run.take_step("align", align, measures=False)
        if not await self.places.still_held(S.ALIGN):
            return
        forced = await run.take_step("insertion", lambda: self._push(lease, T_slot, near), measures=False)
        await self._judge_push(lease, T_slot, near, forced)

    async def _push(self, lease: MotionLease, T_slot: RigidTransform, near: RigidTransform) -> bool:
        """Into the slot along its axis until a force or the whole travel ends it."""
        run, insertion = self.run, self.config.insertion
        await run.enter(S.INSERT)
        await self._back_out(lease, T_slot, near)
        before = await run.arm_state()
        end = self.config.opening.depth_m + insertion.tolerance_m
        forced = await lease.guarded_move(
            self.stations.front_at(T_slot, end),
            insertion.max_force_n,
            end + insertion.near_m + insertion.tolerance_m,
            self._slow(),
        )
        self._note_travel(T_slot, before, await run.arm_state())
        return forced

    async def _judge_push(
        self, lease: MotionLease, T_slot: RigidTransform, near: RigidTransform, forced: bool
    ) -> None:
        """By travel and force: seated and let go; else drawn back, and what is held stays held."""
        travel, wanted = present(self.travel_m, "travel"), self.config.opening.depth_m
        tolerance = self.config.insertion.tolerance_m
        if not await self.places.still_held(S.INSERT):
            await self._retreat(lease, near)
        elif forced and abs(travel - wanted) <= tolerance:
            self.note_part(PartState.INSERTED)
            await self.run.enter(S.RELEASE)
            await self.run.take_step("let go of the part", self.places.let_go, measures=False)
            await self._retreat(lease, self.stations.front_at(T_slot, -self.config.insertion.clear_m))
        elif forced:
            why = f"jammed: {present(self.force_n, 'force'):.1f} N after {mm(travel)} of {mm(wanted)}"
            self.note_part(PartState.JAMMED, why)
            await self._retreat(lease, near)
        else:
            self.note_part(PartState.GRIPPED, f"not-seated: no end of the slot was felt within {mm(travel)}")
            await self._retreat(lease, near)

    async def _pull(self, lease: MotionLease) -> bool:
        """Take the part out of the slot, and put it down where that is configured; whether that went well."""
        run = self.run
        route, T_slot, _ = await self._measure(lease, "part")
        depth = self.config.opening.depth_m
        seated = self.stations.front_at(T_slot, depth)
        above = self.stations.front_at(T_slot, depth - self._above_m())
        out = self.stations.front_at(T_slot, -self.config.insertion.clear_m)

        async def take() -> None:
            await run.enter(S.PULL)
            if self.stations.among_slots((await run.arm_state()).T_base_flange):  # taken again
                if await self.places.gripped_before():  # moved under the force guard alone
                    return
                await lease.move_linear(out, self._slow())
            await lease.move_joints(np.array(route.before))
            await lease.move_linear(above)
            await lease.move_linear(seated, self._slow())
            await self.places.grip(f"slot {self.config.slot}")

        await run.take_step("take the part", take, measures=False)

        before: ArmState | None = None

        async def draw() -> bool:
            """Taken again, it goes on under the load that is there: a guarded move counts from its start."""
            nonlocal before
            now = await run.arm_state()
            before = before or now
            load = float(np.linalg.norm(now.tcp_force[:3] - before.tcp_force[:3]))
            left = self.config.insertion.max_force_n - load
            forced = left <= 0.0
            if not forced:
                length = depth + self.config.insertion.clear_m
                forced = await lease.guarded_move(out, left, length, self._slow())
            self._note_travel(T_slot, before, await run.arm_state())
            return forced

        if await run.take_step("pull the part", draw, measures=False):
            self.note_part(
                PartState.JAMMED, f"jammed: {present(self.force_n, 'force'):.1f} N while it was pulled"
            )
            await run.take_step("let go of the part", self.places.let_go, measures=False)
            await self._retreat(lease, out)
            return False
        if not await self.places.still_held(S.PULL):
            return False
        if self.config.put_down_pose is not None:
            await self.places.put_down(lease)
        return True

    async def _back_out(self, lease: MotionLease, T_slot: RigidTransform, near: RigidTransform) -> None:
        """To where the care begins, when an interruption left the part in the slot."""
        here = (await self.run.arm_state()).T_base_flange
        if self.stations.depth(T_slot, here) > -0.5 * self.config.insertion.near_m:
            await lease.move_linear(near, self._slow())

    async def _retreat(self, lease: MotionLease, T_base_flange: RigidTransform) -> None:
        async def back() -> None:
            await self.run.enter(S.RETREAT)
            await lease.move_linear(T_base_flange, self._slow())

        await self.run.take_step("retreat", back, measures=False)

    def _above_m(self) -> float:
        """How far an open gripper backs off to be clear of a part."""
        part, near = self.config.part, self.config.insertion.near_m
        return max(part.length_m - part.T_tool_part[2], 0.0) + near

    def _slow(self) -> Speed:
        return replace(self.speed, tcp_m_s=min(self.config.insertion.speed_m_s, self.speed.tcp_m_s))

    def _note_travel(self, T_slot: RigidTransform, before: ArmState, now: ArmState) -> None:
        self.travel_m = self.stations.depth(T_slot, now.T_base_flange)
        self.force_n = float(np.linalg.norm(now.tcp_force[:3] - before.tcp_force[:3]))
        self.run.note("decision", event="travel", travel_m=self.travel_m, force_n=self.force_n)

    # -- looks

    async def _measure(
        self, lease: MotionLease, what: str
    ) -> tuple[Route, RigidTransform, Mapping[str, Any] | None]:
        """Look twice: to bring the slot to its preset place in the picture, and from there to measure it."""
        # Whole pictures are looked at; a board that an earlier job looked for costs time in every frame.
        await self.run.take_step("prepare the camera", partial(self.camera.set_target, None))
        rack = self.config.rack
        at = _six(self.stations.nominal_slot())
        sigma = [rack.sigma_m] * 3 + [rack.sigma_rad] * 3
        route = await self.plan()
        await self._look(lease, S.LOOK, what, route, at, sigma, self.config.look.reach_m)
        await self._check_inside(what)
        found = await self.run.worker.call(measured_in_run, self._document(), self.run.folder)
        self.run.note("decision", event="coarse look", **found)
        at, sigma = found["T_base_slot"], [*_MEASURED_SIGMA, *sigma[3:]]
        route = await self.plan(at)
        await self._look(lease, S.MEASURE, what, route, at, sigma, 3.0 * _MEASURED_SIGMA[0])
        found = await self.run.worker.call(measured_in_run, self._document(), self.run.folder)
        self.run.note("decision", event="measured", **found)
        await asyncio.to_thread(self.write)
        T_slot = from_pose6(found["T_base_slot"])
        return await self.plan(found["T_base_slot"]), T_slot, found["budget"]

    async def _look(
        self,
        lease: MotionLease,
        state: S,
        what: str,
        route: Route,
        at: list[float],
        sigma: list[float],
        reach_m: float,
    ) -> None:
        run, look = self.run, self.config.look

        async def take() -> LookTaken:
            await run.enter(state, f"slot {self.config.slot}")
            await lease.move_joints(np.array(route.look))
            await run.clock.sleep(look.settle_s)
            self._looks += 1
            stem = f"look-{self._looks}"
            frames = await self.camera.capture(look.frames, run.folder, stem, run.clock.now())
            arm = await run.arm_state()
            pictures = [(f.colour_file, f.depth_file) for f in frames if f.colour_file and f.depth_file]
            if len(pictures) < look.frames:
                text = f"{self.camera.name} gave {len(pictures)} of {look.frames} pictures"
                raise error("CAMERA_FAULT", text)
            told = frames[0].intrinsics
            lens = solved_lens(run.values, HAND_EYE, told)
            return LookTaken(
                what="part" if what == "part" else "opening",
                q=[float(v) for v in arm.q],
                T_base_camera=_six(arm.T_base_flange * self.stations.T_flange_camera),
                T_base_slot=at,
                sigma=sigma,
                colour=[colour.name for colour, _ in pictures],
                depth=[depth.name for _, depth in pictures],
                camera=Camera.of(told),
                lens=None if lens is None else Camera.of(lens),
                reach_m=reach_m,
                looks=2 if state is S.MEASURE else 1,
            )

        taken = await run.take_step(f"look at slot {self.config.slot}", take)
        self.data = self.data.model_copy(update={"look": taken, "insert_q": route.seated})

    async def _check_inside(self, what: str) -> None:
        """``SLOT_OCCUPIED`` or ``SLOT_EMPTY`` when depth says so, or says nothing."""
        look = present(self.data.look, "look").look(self.run.folder)
        opening = self.config.opening
        rectangle = self.stations.opening()
        deeper = (await asyncio.to_thread(inside, look, rectangle)).deeper
        self.run.note("decision", event="inside", deeper_m=deeper)
        wanted, depth = what == "part", opening.depth_m
        if deeper is not None and (deeper < _FULL * depth if wanted else deeper > _EMPTY * depth):
            return
        seen = "depth does not tell" if deeper is None else f"it is {mm(deeper, 1)} deep behind its opening"
        raise error("SLOT_EMPTY" if wanted else "SLOT_OCCUPIED", f"slot {self.config.slot}: {seen}")

    # -- on disk

    def write(self) -> Path:
        """The data set as it is now; blocks on the disk."""
        path = self.run.folder / DATA_FILE
        write_atomic(path, json.dumps(self._document(), indent=1, allow_nan=False) + "\n")
        return path

    def _document(self) -> dict[str, Any]:
        outcome = InsertionOutcome(
            states=self.part,
            travel_m=self.travel_m,
            force_n=self.force_n,
            reasons=self.reasons,
            confirmed=self.run.grips_confirmed(),
        )
        return self.data.model_copy(update={"outcome": outcome}).model_dump(mode="json", by_alias=True)


def _six(T: RigidTransform) -> list[float]:
    return [float(v) for v in to_pose6(T)]
