"""Job ``belt-calibration``: what one count of the encoder moves the belt by, and which way, in the base.

With a camera, items are seen while the belt carries them. By touch, an operator jogs the tool's point to a
mark before and after the belt has moved. The job itself never moves anything.
"""

import asyncio
from collections import deque
from collections.abc import Mapping
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from cell.calibrations import belt_scale
from cell.devices import EncoderState, Frame, Intrinsics
from cell.errors import CellError
from cell.formats.result import Envelope
from cell.poses import from_pose6, to_pose6
from cell.procedure import FinishRequested, Procedure, Proposal, Run
from cell.run_values import RunValues
from cell.samples import Sample
from procedures.belt.calibrating.config import BeltCalibrationConfig
from procedures.belt.calibrating.record import CalibrationRecord
from procedures.belt.calibrating.rows import ItemFollower, count_at, motion_of
from procedures.belt.calibrating.solving import solve_within_limits
from procedures.belt.camera_to_belt import CameraToBelt
from procedures.belt.count_origin import CountOrigin
from procedures.belt.encoder_alarms import Emergencies
from procedures.belt.result import BeltCalibrationResult
from procedures.trends import keep_trends

CAMERA = "fixed_camera"
LOOK_S = 0.2
STILL_S = 0.3  # arm and belt, before a touch counts
STILL_COUNTS = 1
STILL_TIMEOUT_S = 2.0
RECENT = 2000  # counts among which an exposure is looked for


class State(StrEnum):
    """Where the job is."""

    PREPARE = "prepare"
    WATCH = "watch"  # items go by
    STANDING = "standing"  # the belt stands
    TOUCH = "touch"  # an operator meets the mark
    SOLVE = "solve"


S = State


class BeltCalibration(Procedure):
    """Measures ``m_per_count`` and ``dir`` of the belt; proposes ``belt.<device>``."""

    name: ClassVar[str] = "belt-calibration"
    number: ClassVar[int] = 6
    kind: ClassVar[str] = "belt-calibration"
    Config = BeltCalibrationConfig
    State = State
    TRANSITIONS: ClassVar[Mapping[Any, frozenset[Any]]] = {
        None: frozenset({S.PREPARE}),
        S.PREPARE: frozenset({S.WATCH, S.TOUCH}),
        S.WATCH: frozenset({S.WATCH, S.STANDING, S.SOLVE}),
        S.STANDING: frozenset({S.WATCH, S.SOLVE}),
        S.TOUCH: frozenset({S.TOUCH, S.SOLVE}),
        S.SOLVE: frozenset(),
    }
    CHECKPOINTS: ClassVar[frozenset[Any]] = frozenset({S.WATCH, S.STANDING, S.TOUCH})

    config: BeltCalibrationConfig

    def uses(self) -> tuple[str, ...]:
        # By touch the arm is only read. As a device in use it would have to be ready to move, and an arm
        # that is jogged at its pendant is in local mode.
        return (CAMERA, "belt") if self.config.source == "camera" else ("belt",)

    def check(self, values: RunValues) -> None:
        _camera_to_belt(self.config, values)

    def proposal(self, run: Run) -> Proposal | None:
        if not isinstance(run.result, BeltCalibrationResult):
            return None
        answer = run.result.result
        value = {"m_per_count": answer.m_per_count, "dir": answer.dir}
        return Proposal(belt_scale(run.encoder().name), value, self.config.accept.auto)

    async def run(self, run: Run) -> None:
        await run.enter(S.PREPARE)
        with _Session(self.config, run) as session:
            try:
                await (
                    session.touch()
                    if session.camera_to_belt is None
                    else session.watch(session.camera_to_belt)
                )
            except FinishRequested:
                session.early = "after " + session.progress()
            finally:
                await asyncio.to_thread(session.record.flush)
        await run.enter(S.SOLVE, session.progress())
        path = await asyncio.to_thread(session.record.write_data_set, session.header())
        run.result = found = await run.worker.call(solve_within_limits, path, self.config.model_dump())
        if isinstance(found, BeltCalibrationResult):
            name = f"belt.m_per_count.{run.encoder().name}"
            await keep_trends(run, {name: found.result.m_per_count})

    async def dry_run(self, run: Run) -> dict[str, Any]:
        """What is waited for; nothing moves."""
        config = self.config
        what = (
            f"{config.sightings} sightings over {config.travel_m:g} m of the belt's way"
            if config.source == "camera"
            else f"{config.touches} touches of one mark on the belt"
        )
        return {"poses": [], "note": f"the job moves nothing; it waits for {what}"}

    @classmethod
    def solve_again(cls, path: Path, info: Mapping[str, Any], recorded: Mapping[str, Any]) -> Envelope:
        return solve_within_limits(path, info["job_config"])


def _camera_to_belt(config: BeltCalibrationConfig, values: RunValues) -> CameraToBelt | None:
    """What the camera sees of the belt; None with touches, which need no camera."""
    if config.source == "touch" or config.belt_z_m is None:
        return None
    return CameraToBelt(values, config.belt_z_m, config.items)


class _Session:
    """``with``: listens to the encoder, and to the camera while it watches."""

    def __init__(self, config: BeltCalibrationConfig, run: Run) -> None:
        self.config, self.run = config, run
        self.encoder = run.encoder()
        self.record = CalibrationRecord(run.folder)
        self.early: str | None = None
        self._emergencies = Emergencies(
            self.encoder, lambda what: run.note("decision", event="encoder emergency", what=what)
        )
        self._told: Intrinsics | None = None  # of the camera that sees the items
        self._fresh: deque[Frame] = deque()
        self._follower = ItemFollower(motion_of(self._configured))
        self.camera_to_belt = _camera_to_belt(config, run.values)
        self._origin = CountOrigin(
            self.encoder, self._configured, lambda event, **what: run.note("decision", event=event, **what)
        )
        self._begins: deque[float] = deque()  # times when it began anew, which no frame was after yet
        self._undo: list[Any] = []

    def __enter__(self) -> "_Session":
        self._undo = [self.encoder.counts.subscribe(self._count)]
        if self.camera_to_belt is not None:
            self._undo.append(self.run.camera(CAMERA).frames.subscribe(self._frame))
        return self

    def __exit__(self, *_: object) -> None:
        for undo in self._undo:
            undo()

    def header(self) -> dict[str, Any]:
        """What the solver needs beside the rows."""
        camera_to_belt, told = self.camera_to_belt, self._told
        return {
            "source": self.config.source,
            "device": self.encoder.name,
            "period_s": self.encoder.period_s,
            "T_base_camera": None
            if camera_to_belt is None
            else to_pose6(camera_to_belt.T_base_camera).tolist(),
            "camera": None if camera_to_belt is None or told is None else camera_to_belt.camera(told),
            "configured": self._configured,
            "finished_early": self.early,
            "emergencies": self._emergencies.told,
        }

    def progress(self) -> str:
        """How much there is, in words."""
        if self.camera_to_belt is None:
            return f"{len(self.record.touches)} touches"
        return f"{len(self._follower)} sightings"

    @property
    def _configured(self) -> Mapping[str, Any] | None:
        belt: Mapping[str, Any] | None = self.run.values.configured.get(belt_scale(self.encoder.name))
        return belt

    # -- by camera

    async def watch(self, camera_to_belt: CameraToBelt) -> None:
        """Until enough was seen over a way that is long enough, or patience ends."""
        run, config, camera = self.run, self.config, self.run.camera(CAMERA)
        await run.take_step("prepare the camera", partial(camera.set_items, camera_to_belt.spec()))
        try:
            await run.enter(S.WATCH)
            waited_since = run.clock.now()
            before = 0
            while not self._enough(camera_to_belt):
                await run.clock.sleep(LOOK_S)
                await self._keep()
                if run.wants_rest:
                    await run.enter(S.WATCH)
                if self._belt_stands():
                    if not await self._stood():
                        return
                    waited_since = run.clock.now()
                if len(self._follower) > before:
                    before, waited_since = len(self._follower), run.clock.now()
                elif run.clock.now() - waited_since > config.patience_s:
                    self.early = f"as no item was seen for {config.patience_s:g} s, after {self.progress()}"
                    return
        finally:
            await asyncio.shield(camera.set_items(None))

    async def _stood(self) -> bool:
        """Wait while the belt stands; False when patience or the operator ended that."""
        run, config = self.run, self.config
        await run.enter(S.STANDING)
        run.suspend("the belt stands")
        until = run.clock.now() + config.patience_s
        while self._belt_stands():
            if run.wants_rest:
                run.unsuspend()
                await run.enter(S.WATCH)
                return True
            if run.clock.now() >= until:
                run.unsuspend()
                self.early = f"as the belt stood for {config.patience_s:g} s, after {self.progress()}"
                return False
            await run.clock.sleep(LOOK_S)
            await self._keep()
        run.unsuspend()
        await run.enter(S.WATCH)
        return True

    def _enough(self, camera_to_belt: CameraToBelt) -> bool:
        while (
            self._fresh and self.record.counts and self._fresh[0].exposed_until <= self.record.counts[-1][0]
        ):
            frame = self._fresh.popleft()
            while self._begins and self._begins[0] <= frame.t_exposure:
                self._begins.popleft()
                self._follower.begin()
            recent = np.array([(t, count) for t, count, _ in self.record.counts[-RECENT:]])
            views = frame.items or ()
            times = [frame.t_exposure, *(frame.t_of(view.point) for view in views)]
            counts = [(t, count) for t in times if (count := count_at(recent, t)) is not None]
            if len(counts) == len(times):
                points = camera_to_belt.T_base_camera.apply(np.array([view.point for view in views]))
                self._follower.add(*counts[0], points, counts[1:])
        seen = len(self._follower)
        self.run.progress(min(seen, self.config.sightings), self.config.sightings)
        return seen >= self.config.sightings and self._follower.way_m >= self.config.travel_m

    def _belt_stands(self) -> bool:
        now, span = self.run.clock.now(), self.config.standing_s
        recent = self.encoder.counts.between(now - span, now)
        if not recent or recent[-1].t - recent[0].t < 0.9 * span - 2.0 * self.encoder.period_s:
            return False
        counts = [sample.value.count for sample in recent]
        return max(counts) - min(counts) <= STILL_COUNTS

    async def _keep(self) -> None:
        if (changed := self._origin.changed) and self.camera_to_belt is None:
            raise changed  # two touches are compared by their counts
        await asyncio.to_thread(self.record.flush)

    # -- by touch

    async def touch(self) -> None:
        """One mark on the belt, met with the tool's point, the belt moved, and met again."""
        run, touches = self.run, self.config.touches
        why = ""
        while len(self.record.touches) < touches:
            k = len(self.record.touches)
            await run.enter(S.TOUCH, f"touch {k + 1} of {touches}")
            run.progress(k, touches)
            moved = (
                "Lift the tool, let the belt run on its usual way, and stop it. " if k else "Stop the belt. "
            )
            mark = "the same mark" if k else "a mark"
            await run.ask(
                f"{why}{moved}Jog the arm so that the tool's point touches {mark} on the belt, and confirm "
                f"(touch {k + 1} of {touches})."
            )
            why = await self._take_touch()
            await self._keep()

    async def _take_touch(self) -> str:
        """Note the touch once arm and belt stand; what did not, when they do not.

        A short silence of one of them is waited out.
        """
        run, arm = self.run, self.run.arm()
        silent_until = run.clock.now() + run.steps_taken.limits.until_lost_s
        until = run.clock.now() + STILL_TIMEOUT_S
        moving = "arm"
        while run.clock.now() < until:
            await run.clock.sleep(STILL_S)
            now = run.clock.now()
            states = [s.value for s in arm.state.between(now - STILL_S, now)]
            counts = [s.value.count for s in self.encoder.counts.between(now - STILL_S, now)]
            try:
                arm.state.latest(STILL_S)
                self.encoder.counts.latest(STILL_S)
            except CellError:
                if now > silent_until:
                    raise
                until = now + STILL_TIMEOUT_S
                continue
            if not all(state.at_rest for state in states):
                moving = "arm"
            elif max(counts) - min(counts) > STILL_COUNTS:
                moving = "belt"
            else:
                tool = from_pose6(run.values.tool["T_flange_tool"])
                point = np.mean([(s.T_base_flange * tool).translation for s in states], axis=0)
                entry = {"t": now, "count": float(np.mean(counts)), "point": point.tolist()}
                self.record.touches.append(entry)
                run.note("decision", event="touch", count=entry["count"], point=entry["point"])
                return ""
        return f"The {moving} still moved, so that touch was not taken. "

    # -- what comes in

    def _count(self, sample: Sample[EncoderState]) -> None:
        self._emergencies.count(sample)
        if self._origin.moved(sample):
            self.record.begins.append(sample.t)
            self._begins.append(sample.t)
        self.record.counts.append((sample.t, sample.value.count, sample.value.raw))

    def _frame(self, sample: Sample[Frame]) -> None:
        frame = sample.value
        if frame.items:
            self._fresh.append(frame)
            self._told = self._told or frame.intrinsics
            late = [frame.t_of(view.point) - frame.t_exposure for view in frame.items]
            after = {"after_s": late} if frame.row_time_s else {}
            self.record.sightings.append(
                {
                    "t": frame.t_exposure,
                    "seq": frame.seq,
                    **after,
                    "points": [view.point.tolist() for view in frame.items],
                    "sigma_m": [view.sigma_m for view in frame.items],
                }
            )
