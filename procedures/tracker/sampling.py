"""One sampling from the first look to the last: poses, retries, monuments, and what is on disk of them."""

import asyncio
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.identification.registration import Registration, robust_register
from cell.devices import StablePoint
from cell.errors import CellError, error
from cell.poses import Array
from cell.procedure import FinishRequested, Run
from cell.samples import Sample
from procedures.tracker.arms import MovedArm, SampledArm, WatchedArm
from procedures.tracker.config import TrackerSamplingConfig
from procedures.tracker.eye import AGAIN, LOST, Eye
from procedures.tracker.locating import apart, locate, pose6_of, registration_of
from procedures.tracker.monuments import drift_summary, first_seen
from procedures.tracker.plan import PlanRequest, SamplingPlan, Visit, measured_entries, plan_sampling
from procedures.tracker.record import SampleRecord
from procedures.tracker.space import Space, make_space, robot_of
from procedures.tracker.states import State as S
from procedures.tracker.stored import StoredSet, load_stored
from procedures.tracker.watch import MonumentWatch

LOST_IN_A_ROW = 5
LEAST_POINTS = 3  # for the tracker's place
PLACE_TRUST_M = 0.4  # of a reflector seen from where T_base_tracker_nominal has the tracker
ELSEWHERE_M, ELSEWHERE_RAD = 0.03, 0.01  # a plan holds where the tracker stands no further off than this
SKIPPED = ("MOTION_LIMIT", "MOTION_COLLISION", "MOTION_UNREACHABLE", "OBSERVED_ARM_NOT_THERE")


class Sampling:
    """The data and the devices of one run, and the steps that work on them."""

    def __init__(self, config: TrackerSamplingConfig, run: Run) -> None:
        self.config, self.run = config, run
        self.arm: SampledArm = MovedArm(run) if config.arm == "arm" else WatchedArm(run, config)
        self.eye = Eye(run, config)
        self.record = SampleRecord(run.folder)
        self.watch = MonumentWatch(run, config, self.eye, self.record)
        noise = self.eye.tracker.noise
        self.noise = {"sigma0": noise.sigma0_m, "sigma_per_m": noise.sigma_per_m}
        self.space: Space = make_space(run.values, config, self.noise, None)
        self.reflectors = list(config.reflectors)
        self.place: Registration | None = None
        if config.T_base_tracker_nominal is not None:
            self.place = registration_of(config.T_base_tracker_nominal)
        self.listing: dict[str, Any] = {}
        self.serials: dict[str, str] = {}  # of "arm" and "tracker"
        self._stored: StoredSet | None = None
        self._mounted: str | None = None
        self._lost: list[tuple[Visit, str]] = []

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
        self.serials = {
            role: (await run.cell.device(device).identify()).serial
            for role, device in (("arm", config.arm), ("tracker", "tracker"))
        }
        for name in (*config.reflectors, *config.monuments):
            await self.eye.tracker.select(name)  # one that it does not know shall not show after an hour
        adopted = await self._begin_record()
        if adopted:
            await self.look_at_monuments()
            plan = await self._plan()
        else:
            plan = await self._plan()
            T_planned = config.T_base_tracker_nominal
            await self._locate(plan)
            if config.monuments:
                await self.look_at_monuments()
            if T_planned is None or self._elsewhere(T_planned):
                plan = await self._plan()
        self.listing = plan.listing
        for batch in self._batches(plan.visits):
            await self._mount(batch[0].reflector)
            await self._take_batch(batch)
            if config.monuments and self.record.unlooked >= config.monument_every:
                await self.look_at_monuments()
        if again := [visit for visit, _ in self._lost]:
            self._lost = []
            for batch in self._batches(again):
                await self._mount(batch[0].reflector)
                await self._take_batch(batch, give_up=False)

    async def plan(self) -> SamplingPlan:
        """The plan as it would be now; nothing moves."""
        stored = await self._stored_set()
        place = None if self.place is None else pose6_of(self.place)
        values = {k: v for k, v in self.run.values.items() if k not in ("laser_reference", "kinematics")}
        request = PlanRequest(
            values=values,
            config=self.config.model_dump(),
            noise=self.noise,
            T_base_tracker=place,
            q_start=[float(v) for v in self.arm.now()],
            measured=measured_entries(self.record.samples),
            stored=[] if stored is None else stored.entries(),
        )
        return await self.run.worker.call(plan_sampling, request)

    async def _plan(self) -> SamplingPlan:
        known = (
            "where the tracker stands is known" if self.place is not None else "wherever the tracker stands"
        )
        await self.run.enter(S.PLAN, known)
        plan = await self.plan()
        self.run.note("decision", event="plan", plan=plan.listing)
        return plan

    async def _stored_set(self) -> StoredSet | None:
        """Read once: it shall not change while the run goes on."""
        if self._stored is None and self.config.with_set is not None:
            robot, payload_kg = (
                robot_of(self.run.values, self.config),
                payload_of(self.config, self.run.values),
            )
            self._stored = await asyncio.to_thread(load_stored, self.config, robot, payload_kg)
            assert self._stored is not None
            self.run.note("decision", event="stored set", poses=len(self._stored.samples))
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
        assert self.record.T_base_tracker is not None
        self._found_at(self.record.T_base_tracker)
        run.note("decision", event="adopted", poses=len(self.record.samples))
        return True

    # -- the tracker's place

    async def _locate(self, plan: SamplingPlan) -> None:
        """Measure a few poses far apart; what is known from then on finds every reflector."""
        run, config = self.run, self.config
        first = self.reflectors[0]
        await run.enter(S.LOCATE, f"{len(plan.locate)} poses")
        wanted = f"Put reflector {first} into its nest. " if config.swap_by_operator else ""
        if self.place is None:
            wanted += f"Point the tracker at reflector {first} and let it lock. "
        if wanted:
            careful = "; the arm moves then" if config.arm == "arm" else ""
            await run.ask(f"{wanted}Confirm when that is done{careful}.")
        self._mounted = first
        measured: list[tuple[Array, Array]] = []
        async with self.arm.session():
            for number, visit in enumerate(plan.locate, 1):
                text = f"pose {number} of {len(plan.locate)} to find the tracker's place with"
                found = await self._visit(visit, PLACE_TRUST_M, text)
                if found is not None:
                    q, sample = found
                    measured.append((sample.value.point, self._drawn(q, first)))
            await run.enter(S.NEXT, "located")
        await run.enter(S.LOCATE, f"{len(measured)} of {len(plan.locate)} poses were measured")
        if len(measured) < LEAST_POINTS and self._why is not None:
            raise self._why
        p_tracker, p_base = (np.array([m[k] for m in measured]).reshape(-1, 3) for k in (0, 1))
        T = pose6_of(locate(p_tracker, p_base, config.max_locate_error_m))
        self._found_at(T)
        await asyncio.to_thread(self.record.place_tracker, T)
        run.note("decision", event="located", T_base_tracker=T)

    def _found_at(self, T_base_tracker: list[float]) -> None:
        self.place = registration_of(T_base_tracker)
        self.space = make_space(self.run.values, self.config, self.noise, T_base_tracker)

    def _elsewhere(self, T_planned: Sequence[float]) -> bool:
        assert self.place is not None
        shift, turn = apart(T_planned, pose6_of(self.place))
        moved = shift > ELSEWHERE_M or turn > ELSEWHERE_RAD
        if moved:
            self.run.note("decision", event="planned anew", shift_m=shift, turn_rad=turn)
        return moved

    def _drawn(self, q: Array, reflector: str) -> Array:
        """(3,): where the drawn arm has a reflector, in the base."""
        target = np.array([self.reflectors.index(reflector)])
        out: Array = self.space.points(np.asarray(q)[None], target)[0]
        return out

    def _expected(self, q: Array, reflector: str) -> Array | None:
        """(3,): where the tracker should see it; None while nobody knows."""
        if self.place is None:
            return None
        out: Array = self.place.to_tracker(self._drawn(q, reflector)[:, None])[:, 0]
        return out

    def _place_anew(self) -> None:
        """All samples tell of the tracker's place; more of them tell it better."""
        samples = self.record.samples
        Q = np.array([s["q"] for s in samples])
        f = self.space.points(Q, np.array([self.reflectors.index(s["target"]) for s in samples])).T
        if np.linalg.matrix_rank(f - f.mean(axis=1, keepdims=True), tol=0.1) == 3:
            p = np.array([s["p_tracker"] for s in samples]).T
            self.place = robust_register(p, f, np.ones(len(samples)))

    # -- poses

    async def _take_batch(self, batch: Sequence[Visit], give_up: bool = True) -> None:
        """Poses without anybody near the arm; ``give_up`` when too many in a row cannot be had."""
        run = self.run
        in_a_row = 0
        waiting = deque(batch)
        async with self.arm.session():
            while waiting:
                visit = waiting.popleft()
                self._show_progress()
                number = len(self.record.samples) + 1
                text = f"pose {number} of {self.config.poses}, reflector {visit.reflector}"
                found = await self._visit(visit, self.config.max_surprise_m, text)
                if found is not None:
                    await self._keep(visit, *found)
                    in_a_row = 0
                    continue
                in_a_row += 1
                if give_up and in_a_row >= LOST_IN_A_ROW:
                    assert self._why is not None
                    raise self._why
            self._show_progress()
            await run.enter(S.NEXT, "the arm rests")

    def _show_progress(self) -> None:
        self.run.progress(len(self.record.samples), self.config.poses)

    async def _visit(
        self, visit: Visit, surprise_m: float, text: str
    ) -> tuple[Array, Sample[StablePoint]] | None:
        """Go there and measure, again where it fails; None when the pose had to be given up."""
        run = self.run
        await run.enter(S.NEXT, text)
        await run.enter(self.arm.travel, text)
        try:
            await self.arm.go(visit, text)
        except CellError as refusal:
            if refusal.name not in SKIPPED:
                raise
            self._give_up(visit, refusal)
            return None
        for attempt in range(1, self.config.retries_per_pose + 2):
            await run.enter(S.SETTLE, f"attempt {attempt}")
            try:
                await self.arm.rest()
                await run.clock.sleep(self.config.settle_s)
                # An arm that is only observed may stand elsewhere than was asked.
                near = self._expected(self.arm.now(), visit.reflector)
                await run.enter(S.MEASURE)
                return await self._measure(visit, near, surprise_m)
            except CellError as failure:
                if failure.name in SKIPPED:
                    self._give_up(visit, failure)
                    return None
                if failure.name not in AGAIN or run.state is S.SETTLE:
                    raise
                run.note("decision", event="pose failed", q=visit.q, attempt=attempt, why=str(failure))
                self._why = failure
                if failure.name in LOST and attempt <= self.config.retries_per_pose:
                    await run.enter(S.REACQUIRE, failure.detail)
                    await self.eye.find_again(near)
        self._give_up(visit, self._why)
        return None

    async def _measure(
        self, visit: Visit, near: Array | None, surprise_m: float
    ) -> tuple[Array, Sample[StablePoint]]:
        """One try: joints (j,) and the point, the arm at rest all the while; one of ``AGAIN`` else."""
        found = await self.eye.measure(visit.reflector, near, surprise_m)
        Q = self.arm.joints(found.t - found.dt, found.t + found.dt)
        target = np.full(len(Q), self.reflectors.index(visit.reflector), dtype=np.int64)
        p = self.space.points(Q, target)
        motion = float(np.max(np.linalg.norm(p - p.mean(axis=0), axis=1)))
        if motion > self.config.max_motion_m:
            raise error("POSE_UNSTABLE", f"the joints moved the reflector by {1e3 * motion:.3f} mm")
        q = Q.mean(axis=0)
        self._require_new(visit, q)
        return q, found

    def _require_new(self, visit: Visit, q: Array) -> None:
        """``OBSERVED_ARM_NOT_THERE`` where the arm was measured before and was not asked to be again.

        A reading set aside to judge the result must not be one of those that are solved.
        """
        if not self._off_plan(q, visit.q):
            return
        before = [] if self._stored is None else self._stored.samples
        for sample in (*before, *self.record.samples):
            if sample["target"] == visit.reflector and not self._off_plan(q, sample["q"]):
                raise error(
                    "OBSERVED_ARM_NOT_THERE",
                    f"{self.arm.name} has not gone where it was asked to, "
                    "it stands where it was measured before",
                )

    def _off_plan(self, q: Array, asked: Sequence[float]) -> bool:
        return float(np.max(np.abs(q - np.array(asked)))) > self.config.pose_tolerance_rad

    _why: CellError | None = None

    def _give_up(self, visit: Visit, why: CellError | None) -> None:
        self._why = why
        self._lost.append((visit, str(why)))
        self.run.note("decision", event="pose skipped", q=visit.q, why=str(why))

    async def _keep(self, visit: Visit, q: Array, found: Sample[StablePoint]) -> None:
        point = found.value
        off = float(np.max(np.abs(q - np.array(visit.q))))
        sample = {
            "index": 1 + max((int(s["index"]) for s in self.record.samples), default=-1),
            "q": [float(v) for v in q],
            "p_tracker": [float(v) for v in point.point],
            "target": visit.reflector,
            "t": found.t,
            "scatter_m": point.scatter_m,
            "held_out": visit.held_out,
            "asked_q": visit.q,
            "notes": {
                "readings": point.count,
                "window_s": point.window_s,
                "temperature_c": point.temperature_c,
                "pressure_pa": point.pressure_pa,
                "warnings": list(point.warnings),
            },
        }
        await asyncio.to_thread(self.record.add_sample, sample)
        elsewhere = {"off_rad": off} if self._off_plan(q, visit.q) else {}
        self.run.note("decision", event="pose taken", index=sample["index"], **elsewhere)
        self._place_anew()

    async def _mount(self, reflector: str) -> None:
        """A person puts the one reflector into the nest that comes next."""
        if not self.config.swap_by_operator or self._mounted == reflector:
            return
        await self.run.enter(S.SWAP, reflector)
        await self.run.ask(f"Put the reflector into nest {reflector} on the flange, then confirm.")
        self._mounted = reflector

    async def look_at_monuments(self) -> None:
        """``TRACKER_MOVED`` when one is not where the first look saw it."""
        assert self.place is not None
        if self.config.swap_by_operator:
            self._mounted = None
        await self.watch.look(self.place, self._behind_arm())
        if self._stored is not None:
            self._stored.require_same_stand(first_seen(self.record.looks), self.config.max_drift_m)

    def _behind_arm(self) -> NDArray[np.bool_]:
        """(n,): which monuments the arm hides from the tracker as it stands, by its links."""
        p = np.array([m.point for m in self.config.monuments.values()]).reshape(-1, 3)
        guard, view = self.space.guard, self.space.view
        if guard is None or view is None:
            return np.zeros(len(p), dtype=bool)
        ends = guard.capsule_ends(self.arm.now()[None])
        return view.hidden(p, np.repeat(ends, len(p), axis=0))

    # -- the end

    def facts(self) -> dict[str, Any]:
        """What a result says of the way it was measured; in the data sets, so that replay says the same."""
        record, config, stored = self.record, self.config, self._stored
        return {
            "arm": self.arm.name,
            "role": config.arm,
            "tracker": self.eye.tracker.name,
            "serials": self.serials,
            "wanted": config.poses,
            "measured": len(record.samples),
            "set_aside": sum(bool(s["held_out"]) for s in record.samples),
            "off_plan": sum(self._off_plan(np.array(s["q"]), s["asked_q"]) for s in record.samples),
            "doubtful": [
                {"index": s["index"], "warnings": s["notes"]["warnings"]}
                for s in record.samples
                if s["notes"].get("warnings")
            ],
            "lost": [{"q": visit.q, "target": visit.reflector, "why": why} for visit, why in self._lost],
            "T_base_tracker": record.T_base_tracker,
            "predicted": self.listing.get("predicted"),
            "stored": stored and {"path": str(stored.path), "samples": len(stored.samples)},
            "reflectors": {name: list(r.point) for name, r in config.reflectors.items()},
            "monument_points": first_seen(record.looks),
            "monuments": drift_summary(record.looks, config.max_drift_m, len(record.samples)),
        }

    def write(self) -> Path:
        """The data sets of what was measured; blocks on the disk."""
        stored = [] if self._stored is None else self._stored.samples
        return self.record.write_data_sets({"sampling": self.facts()}, stored)


def payload_of(config: TrackerSamplingConfig, values: dict[str, Any] | Any) -> float:
    """What hangs on the flange, kg."""
    return float(values["payload_kg"] if config.payload_kg is None else config.payload_kg)


def _why_not_adopted(folder: Path) -> str:
    return f"{folder.name} has no finished pose, or no look at monuments that vouches for the tracker's place"
