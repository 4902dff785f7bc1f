"""One sampling from the first look to the last: plans, batches of poses, looks at the monuments."""

import asyncio
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np

from calibration.identification.reflector_constant import KEY
from cell.errors import CellError, present
from cell.poses import Array
from cell.procedure import FinishRequested, Run
from procedures.laser_tracker.aiming import Eye
from procedures.laser_tracker.locating import locate, pose6_of
from procedures.tracker.arms import LeasedArm, SampledArm, WatchedArm
from procedures.tracker.config import TrackerSamplingConfig
from procedures.tracker.feasible_poses import payload_of, robot_of
from procedures.tracker.monuments import first_seen
from procedures.tracker.plan import PlanRequest, SamplingPlan, Visit, measured_entries, plan_sampling
from procedures.tracker.record import SampleRecord
from procedures.tracker.run_facts import facts
from procedures.tracker.states import State as S
from procedures.tracker.stored import StoredSet, load_stored
from procedures.tracker.tracker_pose import TrackerPose
from procedures.tracker.visiting import Visitor
from procedures.tracker.watch import MonumentWatch

LOST_IN_A_ROW = 5
LEAST_POINTS = 3  # for the tracker's place
PLACE_TRUST_M = 0.4  # of a reflector seen from where T_base_tracker_nominal has the tracker


class SamplingRun:
    """The data and the devices of one run, and the steps that work on them."""

    def __init__(self, config: TrackerSamplingConfig, run: Run) -> None:
        self.config, self.run = config, run
        self.arm: SampledArm = LeasedArm(run) if config.arm == "arm" else WatchedArm(run, config)
        self.eye = Eye(run, config)
        self.record = SampleRecord(run.folder)
        self.watch = MonumentWatch(run, config, self.eye, self.record)
        noise = self.eye.tracker.noise
        self.noise = {
            "sigma0": noise.sigma0_m,
            "sigma_per_m": noise.sigma_per_m,
            KEY: config.constant_sigma_m,
        }
        self.place = TrackerPose(config, run.values, self.noise)
        self.visitor = Visitor(
            run,
            config,
            self.arm,
            self.eye,
            self.place,
            self.record,
            lambda: self._stored.samples if self._stored else (),
        )
        self.serials: dict[str, str] = {}  # of "arm" and "tracker"
        self._planned: SamplingPlan | None = None
        self._stored: StoredSet | None = None
        self._mounted: str | None = None

    # -- the whole

    async def take_all(self) -> None:
        """Everything up to the last pose; after a finish what was taken by then."""
        with suppress(FinishRequested):
            await self._take_all()
        if self.run.state not in (S.NEXT, S.MONUMENTS):
            with suppress(FinishRequested):
                await self.run.enter(S.NEXT, "finished early")
        if self.run.state is S.NEXT and self.record.looks and self.record.unlooked:
            with suppress(FinishRequested):
                await self.look_at_monuments()

    async def _take_all(self) -> None:
        run, config = self.run, self.config
        await run.enter(S.PREPARE)
        self.serials = await run.take_step("ask who the devices are", self._ask_devices)
        if await self._begin_record():
            await self.look_at_monuments()
            plan = await self._plan()
        else:
            plan = await self._plan()
            await self._locate(plan)
            if config.monuments:
                await self.look_at_monuments()
            if self._elsewhere(config.T_base_tracker_nominal):
                plan = await self._plan()
        for batch in self._batches(plan.visits):
            await self._mount(batch[0].reflector)
            await self._take_batch(batch)
            if config.monuments and self.record.unlooked >= config.monument_every:
                await self.look_at_monuments()
        if again := [visit for visit, _ in self.visitor.lost]:
            self.visitor.lost.clear()
            for batch in self._batches(again):
                await self._mount(batch[0].reflector)
                await self._take_batch(batch, give_up=False)

    async def _ask_devices(self) -> dict[str, str]:
        """Their serials; a reflector that the tracker does not know shall not show after an hour."""
        config = self.config
        for name in (*config.reflectors, *config.monuments):
            await self.eye.tracker.select(name)
        return {
            role: (await self.run.cell.device(device).identify()).serial
            for role, device in (("arm", config.arm), ("tracker", "tracker"))
        }

    async def _joints(self) -> Array:
        """(j,): the arm's joints as they are; a short silence is waited out."""

        async def look() -> Array:
            return self.arm.now()

        return await self.run.take_step("look at the arm", look)

    async def plan(self) -> SamplingPlan:
        """The plan as it would be now; nothing moves."""
        stored = await self._stored_set()
        values = replace(self.run.values, laser_reference=None, kinematics={})
        request = PlanRequest(
            values=values,
            config=self.config.model_dump(),
            noise=self.noise,
            T_base_tracker=self.place.T_base_tracker,
            q_start=[float(v) for v in await self._joints()],
            measured=measured_entries(self.record.samples),
            stored=[] if stored is None else stored.entries(),
        )
        return await self.run.worker.call(plan_sampling, request)

    async def _plan(self) -> SamplingPlan:
        known = self.place.registration is not None
        await self.run.enter(
            S.PLAN, "where the tracker stands is known" if known else "wherever the tracker stands"
        )
        plan = self._planned = await self.plan()
        self.visitor.hub = np.array(plan.hub)
        self.run.note("decision", event="plan", plan=plan.listing)
        return plan

    def _elsewhere(self, T_planned: Sequence[float] | None) -> bool:
        """Whether a plan made for a tracker at ``T_planned`` is not good for where it was found."""
        if T_planned is None:
            return True
        away = self.place.elsewhere(T_planned)
        if away is not None:
            self.run.note("decision", event="planned anew", shift_m=away[0], turn_rad=away[1])
        return away is not None

    async def _stored_set(self) -> StoredSet | None:
        """Read once: it shall not change while the run goes on."""
        config, values = self.config, self.run.values
        if self._stored is None and (name := config.with_set) is not None:
            robot, payload_kg = robot_of(values, config), payload_of(config, values)
            self._stored = stored = await asyncio.to_thread(load_stored, name, config, robot, payload_kg)
            stored.require_same_devices(self.serials)
            self.run.note("decision", event="stored set", poses=len(stored.samples))
        return self._stored

    def _batches(self, visits: Sequence[Visit]) -> list[list[Visit]]:
        """Poses between two looks at the monuments, or between two places of a carried reflector."""
        batches: list[list[Visit]] = []
        every = self.config.monument_every if self.config.monuments else len(visits)
        for visit in visits:
            carried = self.config.swap_by_operator and batches and batches[-1][0].reflector != visit.reflector
            if not batches or carried or len(batches[-1]) >= every:
                batches.append([])
            batches[-1].append(visit)
        return batches

    async def _begin_record(self) -> bool:
        """Write the header; True when poses of a run before this one are taken over."""
        config, run = self.config, self.run
        header = {
            "robot": robot_of(run.values, config),
            "noise": self.noise,
            "payload_kg": payload_of(config, run.values),
            "max_drift_m": config.max_drift_m,
            "serials": self.serials,
        }
        adopted = None
        if run.adopted is not None:
            found = await asyncio.to_thread(SampleRecord.read, run.adopted)
            adopted = found.vouched_for(config.max_drift_m)
            if dropped := len(found.samples) - len(adopted.samples):
                why = "a monument was seen elsewhere at the look after them"
                run.note("decision", event="not adopted", poses=dropped, why=why)
            if not (adopted.samples and adopted.looks):
                adopted = None
                run.note("decision", event="nothing adopted", why=_why_not_adopted(run.adopted))
        await asyncio.to_thread(self.record.begin, header, adopted)
        if adopted is None:
            return False
        self.place.found_at(present(self.record.T_base_tracker, "place of the tracker beside adopted poses"))
        run.note("decision", event="adopted", poses=len(self.record.samples))
        return True

    # -- the tracker's place

    async def _locate(self, plan: SamplingPlan) -> None:
        """Measure a few poses far apart; what is known from then on finds every reflector."""
        run, config = self.run, self.config
        first = next(iter(config.reflectors))
        await run.enter(S.LOCATE, f"{len(plan.locate)} poses")
        wanted = f"Put reflector {first} into its nest. " if config.swap_by_operator else ""
        if self.place.registration is None:
            wanted += f"Point the tracker at reflector {first} and let it lock. "
        if wanted:
            careful = "; the arm moves then" if config.arm == "arm" else ""
            await run.ask(f"{wanted}Confirm when that is done{careful}.")
        self._mounted = first
        measured: list[tuple[Array, Array]] = []
        why: CellError | None = None  # the last pose was given up
        async with self.arm.session():
            for number, visit in enumerate(plan.locate, 1):
                text = f"pose {number} of {len(plan.locate)} to find the tracker's place with"
                found = await self.visitor.measure_at(visit, PLACE_TRUST_M, text)
                if isinstance(found, CellError):
                    why = found
                else:
                    q, sample = found
                    measured.append((sample.value.point, self.place.nominal_point(q, first)))
            await run.enter(S.NEXT, "located")
        await run.enter(S.LOCATE, f"{len(measured)} of {len(plan.locate)} poses were measured")
        self.visitor.lost.clear()  # they only locate: none of them is wanted again
        if len(measured) < LEAST_POINTS and why is not None:
            raise why
        p_tracker, p_base = (np.array([m[k] for m in measured]).reshape(-1, 3) for k in (0, 1))
        T = pose6_of(locate(p_tracker, p_base, config.max_locate_error_m))
        self.place.found_at(T)
        await asyncio.to_thread(self.record.place_tracker, T)
        run.note("decision", event="located", T_base_tracker=T)

    async def look_at_monuments(self) -> None:
        """``TRACKER_MOVED`` when one is not where the first look saw it."""
        if self.config.swap_by_operator:
            self._mounted = None
        await self.watch.look(self.place.located, self.place.monuments_hidden(await self._joints()))
        if self._stored is not None:
            self._stored.require_same_stand(first_seen(self.record.looks), self.config.max_drift_m)

    # -- poses

    async def _take_batch(self, batch: Sequence[Visit], give_up: bool = True) -> None:
        """Poses without anybody near the arm; ``give_up`` when too many in a row cannot be measured."""
        run, visitor = self.run, self.visitor
        in_a_row = 0
        waiting = deque(batch)
        async with self.arm.session():
            while waiting:
                visit = waiting.popleft()
                self._show_progress()
                number = len(self.record.samples) + 1
                text = f"pose {number} of {self.config.poses}, reflector {visit.reflector}"
                found = await visitor.measure_at(visit, self.config.max_surprise_m, text)
                if not isinstance(found, CellError):
                    await visitor.keep(visit, *found)
                    in_a_row = 0
                    continue
                in_a_row += 1
                if give_up and in_a_row >= LOST_IN_A_ROW:
                    raise found
            self._show_progress()
            await run.enter(S.NEXT, "the arm rests")

    def _show_progress(self) -> None:
        self.run.progress(len(self.record.samples), self.config.poses)

    async def _mount(self, reflector: str) -> None:
        """A person puts the one reflector into the nest that comes next."""
        if not self.config.swap_by_operator or self._mounted == reflector:
            return
        await self.run.enter(S.SWAP, reflector)
        await self.run.ask(f"Put the reflector into nest {reflector} on the flange, then confirm.")
        self._mounted = reflector

    # -- the end

    def write(self) -> Path:
        """The data sets of what was measured; blocks on the disk."""
        stored = [] if self._stored is None else self._stored.samples
        told = facts(
            self.config,
            self.record,
            self._stored,
            off_plan=sum(self.visitor.off_plan(np.array(s["q"]), s["asked_q"]) for s in self.record.samples),
            lost=self.visitor.lost,
            predicted=None if self._planned is None else self._planned.listing["predicted"],
            devices={"arm": self.arm.name, "tracker": self.eye.tracker.name, "serials": self.serials},
        )
        return self.record.write_data_sets({"sampling": told}, stored)


def _why_not_adopted(folder: Path) -> str:
    return f"{folder.name} has no finished pose, or no look at monuments that vouches for the tracker's place"
