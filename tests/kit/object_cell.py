"""A whole cell in this process on virtual time: world, supervisor, engine, and an operator."""

import asyncio
import json
from collections.abc import AsyncIterator, Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any, TypeVar

import pytest

from cell.devices import DeviceState
from cell.errors import CellError
from cell.motion import MotionBroker
from cell.store.ledger import Ledger
from cell.store.runs import RunFolder, interrupted_runs, load_run
from daemon.cell_context import CellContext
from daemon.composition import supervised_devices
from daemon.config import CellConfig, load_config
from daemon.engine import Engine
from daemon.health import Beats
from daemon.results import reject_left_open
from daemon.start_request import StartRequest
from daemon.supervisor import Supervisor
from daemon.worker import InlineWorker
from fakes.object import ObjectCell as Plant
from fakes.object import VirtualClock, cell_of
from fakes.world.scenario import OBSERVED, Scenario
from procedures.documents import read_result
from procedures.hand_eye.plan import plan_placement
from procedures.laser.plan import plan_scan
from procedures.registry import JOBS
from procedures.tracker.plan import plan_sampling
from tests.kit.remembered import remembered

R = TypeVar("R")

PLANNERS: dict[Callable[..., Any], Callable[..., Any]] = {
    plan: remembered(plan) for plan in (plan_placement, plan_scan, plan_sampling)
}

JOB = "cone-capture"
ASKING = (JOB, "laser-reference")  # the jobs that ask before they begin
WHO = "test"
SELDOM = {"state_period_s": 0.02}  # of the arm: the longest there is
SMALL = {"placements": 1, "poses_per_placement": 4, "frames_per_pose": 2, "settle_s": 0.1}


def write_config(
    folder: Path,
    scenario: str = "hand_eye:ideal",
    job: Mapping[str, Any] | None = None,
    arm_keys: Mapping[str, Any] | None = None,
    beams_keys: Mapping[str, Any] | None = None,
    tracker_keys: Mapping[str, Any] | None = None,
    observed_keys: Mapping[str, Any] | None = None,
    gripper_keys: Mapping[str, Any] | None = None,
    jobs: Mapping[str, Mapping[str, Any] | None] | None = None,
    camera: str = "fakes.object:ObjectCamera",
    **overrides: Any,
) -> CellConfig:
    """The scenario's own cell on the object face with a small plan.

    ``job`` goes into the section of the capture, ``jobs`` into those of other jobs, None leaves a job out;
    ``camera`` is the driver of the camera. The arm tells its state 50 times a second, not 100 times as by
    default, which takes an eighth of the time of most tests.
    """
    loaded = Scenario.load(scenario)
    sections = {name: dict(section) for name, section in loaded.cell.job.items()}
    for name, keys in (jobs or {}).items():
        if keys is None:
            sections.pop(name, None)
            continue
        merged = {**sections.get(name, {}), **keys}
        sections[name] = {key: value for key, value in merged.items() if value is not None}
    if JOB in sections:
        sections[JOB] |= {**SMALL, **(job or {})}
    text = loaded.cell_toml(
        {
            name: {"driver": driver, "scenario": scenario, **(keys or {})}
            for name, driver, keys in (
                ("arm", "fakes.object:ObjectArm", {**SELDOM, **(arm_keys or {})}),
                ("camera", camera, None),
                ("beams", "fakes.object:ObjectInputs", beams_keys),
                ("tracker", "fakes.object:ObjectTracker", tracker_keys),
                (
                    OBSERVED,
                    "fakes.object:ObjectObservedArm",
                    {"allow_requests": True, **(observed_keys or {})},
                ),
                ("belt", "fakes.object:ObjectEncoder", None),
                ("gripper", "fakes.object:ObjectGripper", gripper_keys),
                ("place_inputs", "fakes.object:ObjectPlaceInputs", None),
            )
        },
        state_dir=str(folder / "state"),
        control_socket=str(folder / "control.sock"),
        clock="fakes.object:VirtualClock",
        overrides={"job": sections, **overrides},
    )
    loaded.write_robots(folder)
    path = folder / "cell.toml"
    path.write_text(text, "utf-8")
    path.chmod(0o600)
    return load_config(path)


class Eager(InlineWorker):
    """Computes at once, but takes ``takes_s`` of the cell's time, so that things can happen meanwhile."""

    def __init__(self, clock: VirtualClock, takes_s: float = 0.2) -> None:
        self._clock, self._takes_s = clock, takes_s

    async def call(self, fn: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
        await self._clock.sleep(self._takes_s)
        return PLANNERS.get(fn, fn)(*args, **kwargs)


class ObjectCell:
    """Supervisor and engine on an object world, and what an observer sees of them."""

    def __init__(self, config: CellConfig, clock: VirtualClock, job: str = JOB) -> None:
        self.config, self.clock, self.job = config, clock, job
        self.beats = Beats(clock)
        self.supervisor = Supervisor(supervised_devices(config, clock, self.beats))
        state = Path(config.cell.state_dir)
        self.runs = state / "runs"
        self.runs.mkdir(parents=True, exist_ok=True)
        self.ledger = on_disk(Ledger, state / "ledger.sqlite")
        self.context = CellContext(
            config, clock, Eager(clock), self.supervisor, MotionBroker(clock), self.ledger
        )
        self.engine = Engine(self.context, JOBS, self.runs)
        self._tasks: list[asyncio.Task[None]] = []

    @property
    def plant(self) -> Plant:
        """The physical side: world, controller, camera head."""
        return cell_of(self.config.device["arm"].scenario, self.clock)  # type: ignore[attr-defined]

    # -- life

    async def open(self) -> None:
        """Connect all devices and wait until they are READY."""
        for run in await asyncio.to_thread(interrupted_runs, self.runs):
            await asyncio.to_thread(run.mark_interrupted)
            self.engine.interrupted.append(run.run_id)
        await asyncio.to_thread(reject_left_open, self.ledger, JOBS)
        self._tasks = [
            asyncio.create_task(entry.run(), name=f"device {name}")
            for name, entry in self.supervisor.devices.items()
        ]
        await self.until(self.all_ready, "ready devices")

    async def close(self) -> None:
        """The end of the daemon: a job that runs is halted, devices are closed."""
        await self.engine.shutdown()
        await self._cancel_devices()

    async def kill(self) -> None:
        """The end of a process as far as one process can show it: the job stops without a word."""
        for task in (self.engine._job, self.engine._task):
            if task is not None:
                task.cancel()
                await asyncio.wait([task])
        await self._cancel_devices()

    async def _cancel_devices(self) -> None:
        for task in self._tasks:
            task.cancel()
        if self._tasks:
            await asyncio.wait(self._tasks)
        self.ledger.close()

    def all_ready(self) -> bool:
        return all(d.state is DeviceState.READY for d in self.supervisor.devices.values())

    # -- running jobs

    async def start(self, *, placed: bool = True, **how: Any) -> int:
        """Start the cell's job, or ``job``; returns the run's number.

        ``placed``: the operator says at once that the board stands where the first placement is to be, or
        that the good tool is mounted.
        """
        params, job = how.pop("params", {}), how.pop("job", self.job)
        begun = await self.engine.start(StartRequest(job, params, WHO, "test", **how))
        if placed and job in ASKING:
            await self.until(lambda: self._asks() or self._under_way(), "a prompt")
            if not self._under_way():
                await self.answer()
        return int(begun["run_id"])

    @property
    def state(self) -> str | None:
        """Of the job that runs, as ``status`` tells it; all of that is a fifth of a short test's time."""
        run = self.engine.running
        return run.state.value if run and run.state else None

    def _asks(self) -> bool:
        run = self.engine.running
        return run is not None and run.prompt is not None

    def _under_way(self) -> bool:
        """Whether the job is beyond the first thing that it asks, or ended."""
        return not self.engine.active or self.state not in (None, "prepare", "place")

    async def dry_run(self) -> dict[str, Any]:
        """``run_id`` and ``plan`` of the cell's job, listed without a move."""
        return await self.engine.start(StartRequest(self.job, {}, WHO, "test", dry_run=True))

    async def run_job(self, **how: Any) -> dict[str, Any]:
        """Start a job, be its operator, and return its ``end.json``."""
        return await self.finished(await self.start(**how))

    async def finished(self, run_id: int) -> dict[str, Any]:
        """Move the board and confirm whenever the job asks; the run's ``end.json``."""
        while self.engine.active:
            await self.answer()
            await self.clock.sleep(0.05)
        return self.end(run_id)

    async def answer(self) -> None:
        """Move the board to the next place (it stands where the first is to be) and confirm, if asked.

        This operator finishes a job that has trouble with a placement.
        """
        run = self.engine.run
        if run is not None and run.prompt is not None:
            text = run.prompt[1]
            if "Or skip the placement" in text and "since the interruption" not in text:
                await self.engine.finish(WHO)
                return
            if self.plant.world.operator.placements and not text.startswith("Placement 1 "):
                self.plant.world.operator.move_on(self.clock.now())
            await self.engine.confirm(run.prompt[0], WHO)

    async def until(self, true: Callable[[], Any], what: str, limit_s: float = 60.0) -> None:
        give_up = self.clock.now() + limit_s
        while not true():
            assert self.clock.now() < give_up, f"no {what} within {limit_s:g} s"
            await self.clock.sleep(0.02)

    async def until_state(self, state: str, limit_s: float = 120.0) -> None:
        """Wait until the job is in this state."""
        await self.until(lambda: self.state == state, f"state {state}", limit_s)

    def at_state(self, state: str, act: Callable[[], None], after_s: float = 0.0, times: int = 1) -> None:
        """Do something the moment the job enters ``state`` for the first ``times``, or ``after_s`` later."""
        left, last = times, 0
        loop = asyncio.get_running_loop()

        def look() -> None:
            nonlocal left, last
            run = self.engine.run
            if not self.engine.active or run is None or len(run.visited) == last:
                return
            last = len(run.visited)
            if left and run.state is not None and run.state.value == state:
                left -= 1
                loop.call_later(after_s, act) if after_s else act()

        self.engine.subscribe(look)

    # -- what is on disk

    def folder(self, run_id: int) -> RunFolder:
        return load_run(self.runs, run_id)

    def journal(self, run_id: int) -> list[dict[str, Any]]:
        return self.folder(run_id).read_journal()

    def notes(self, run_id: int, event: str) -> list[dict[str, Any]]:
        """The journal's lines with this event."""
        return [line for line in self.journal(run_id) if line.get("event") == event]

    def end(self, run_id: int) -> dict[str, Any]:
        end = self.folder(run_id).read_end()
        assert end is not None, "the run has no end.json"
        (terminal,) = [line for line in self.journal(run_id) if line.get("terminal")]
        assert terminal["outcome"] == end["outcome"]
        return end

    def result(self, run_id: int) -> dict[str, Any]:
        result = self.folder(run_id).read_result()
        assert result is not None, "the run has no result.json"
        assert read_result(result).as_json() == result
        return result

    def poses(self, run_id: int) -> list[dict[str, Any]]:
        """The observations of ``capture.json``."""
        text = (self.folder(run_id).path / "capture.json").read_text("utf-8")
        return list(json.loads(text)["observations"])

    def at_rest(self) -> bool:
        """What is truly so, not what the stream says."""
        return not self.plant.world.track.at(self.clock.now())[1].any()


@asynccontextmanager
async def open_cell(
    config: CellConfig, clock: VirtualClock | None = None, job: str = JOB
) -> AsyncIterator[ObjectCell]:
    """A cell with all its devices READY; at the end everything is closed."""
    cell = ObjectCell(config, clock or VirtualClock(), job)
    try:
        await cell.open()
        yield cell
    finally:
        await cell.close()


def on_disk(call: Callable[..., R], *args: Any, **how: Any) -> R:
    """A write to the ledger by a test itself; it waits for the disk, so it is not done on the loop."""
    with ThreadPoolExecutor(1) as thread:
        return thread.submit(call, *args, **how).result()


async def refused(work: Any) -> CellError:
    """The coded error that ``work`` ends with."""
    with pytest.raises(CellError) as caught:
        await work
    return caught.value


@pytest.fixture
def no_report(monkeypatch: pytest.MonkeyPatch) -> None:
    """A report takes longer to draw than the whole run; it has tests of its own."""

    async def drawn(run: Any) -> None: ...

    monkeypatch.setattr("daemon.results._write_report", drawn)
