"""The fast demo: the same jobs in this process, on a world without protocols and a clock without waiting.

Its configuration names drivers and a clock as ``package.module:Class``; that name is all this code knows of
them. The clock's module offers ``run_virtual``, which runs a coroutine on the loop that makes the clock jump.
"""

import asyncio
import importlib
import logging
import re
import time
from collections import Counter
from collections.abc import Sequence
from contextlib import AsyncExitStack
from dataclasses import asdict, replace
from importlib.resources import files
from pathlib import Path
from typing import Any

from cell.clock import Clock
from cell.devices import DeviceState
from cell.errors import CellError, error, present
from cell.motion import MotionBroker
from cell.store.files import to_json, write_atomic
from cell.store.ledger import Ledger
from daemon.cell_context import CellContext
from daemon.cli.failures import FAILED
from daemon.cli.output import out, say
from daemon.cli.progress import ProgressBar
from daemon.composition import supervised_devices
from daemon.config import CellConfig, load_config
from daemon.demo.closing import Row, close_demo
from daemon.demo.cross_checked import cross_check
from daemon.demo.ending import conclude
from daemon.demo.folder import begin_in
from daemon.demo.scenes import DemoScene, give_camera, give_delay, keep_delay, scenes_of
from daemon.demo.steps import Step
from daemon.engine import Engine
from daemon.health import Beats
from daemon.report_index import CellState
from daemon.start_request import StartRequest
from daemon.supervisor import Supervisor
from daemon.worker import InlineWorker
from procedures.registry import JOBS

READY_S = 30.0
MOST_ASKED = 5  # a prompt that comes again at the same step asks for what this operator cannot do
POLL_S = 0.1
WHO = "the demo"
STATE = "fast-state"  # as in fast_*.toml
ROWS_FILE = "rows.json"  # what each step came to, for the demo that this one runs beside


def run_fast(folder: Path, steps: Sequence[Step], ideal: bool = False) -> int:
    """Run the demo with its files in ``folder``, perhaps in ideal worlds; exit code as of the full one."""
    out(f"Cellward demo, fast: {', '.join(s.job for s in steps)} in one process. ETA one minute.")
    if ideal:
        out("The worlds are ideal ones, kinder than any cell.")
    out("All devices and the clock are virtual objects: no process, no protocol and no Modbus is exercised.")
    scenes = scenes_of(steps)
    rows: list[Row] = []
    for scene in scenes:
        try:
            rows += [replace(row, twin=scene.twin) for row in _play(scene, folder / scene.twin, ideal)]
        except CellError as failure:
            say(f"{failure}. {failure.hint}")
            why = f"not done: {failure}"
            rows += [Row(step.job, "-", "-", why, FAILED, scene.twin) for step in scene.steps]
    write_atomic(folder / ROWS_FILE, to_json([asdict(row) for row in rows]))
    return close_demo(rows, [CellState(s.twin, folder / s.twin / STATE) for s in scenes], folder)


def _play(scene: DemoScene, folder: Path, ideal: bool) -> list[Row]:
    begin_in(folder, STATE, "demo")
    logging.basicConfig(filename=folder / "fast.log", level=logging.INFO, force=True)
    scene.prepare(folder)
    config = load_config(write_config(scene, folder, ideal))
    began = time.monotonic()
    played = [step for step in scene.steps if not step.compares]
    runs, seconds = run_objects(config, played)
    say(
        f"The log is {folder / 'fast.log'}. {seconds:.0f} s of the cell took {time.monotonic() - began:.1f} s"
    )
    where = Path(config.cell.state_dir) / "runs"
    done = list(zip(played, runs, strict=True))
    rows = [conclude(where, *run, finds_fault=step.finds_fault) for step, run in done]
    if len(played) < len(scene.steps):
        rows.append(cross_check([(step.job, where, *run) for step, run in done], folder))
    return rows


def run_objects(config: CellConfig, steps: Sequence[Step]) -> tuple[list[tuple[int, dict[str, Any]]], float]:
    """Run the steps on the clock that ``config`` names; numbers and truths, and how long it took there."""
    module, _, name = present(config.cell.clock, "clock in the configuration").partition(":")
    virtual = importlib.import_module(module)
    done: tuple[list[tuple[int, dict[str, Any]]], float]
    done = virtual.run_virtual(_run(config, getattr(virtual, name)(), steps))
    return done


def write_config(scene: DemoScene, folder: Path, ideal: bool = False) -> Path:
    """The configuration of a scene's cell of objects, in ``folder``."""
    text = files("daemon.demo").joinpath(f"fast_{scene.twin}.toml").read_text("utf-8")
    if ideal:
        text = re.sub(r'^(scenario = "[^"]*)"$', r'\1:ideal"', text, flags=re.MULTILINE)
        # The stored set is of the arm with gears and sag: one without is measured at as many poses by itself.
        text = re.sub(r"^poses = \d+\nwith_set = .*$", "poses = 40", text, flags=re.MULTILINE)
    path = folder / "fast.toml"
    path.write_text(text.replace("@FOLDER@", str(folder)), "utf-8")
    return path


async def _run(
    config: CellConfig, clock: Clock, steps: Sequence[Step]
) -> tuple[list[tuple[int, dict[str, Any]]], float]:
    """The number of each run with the truth after it, and how long all took on the cell's clock."""
    state = Path(config.cell.state_dir)
    supervisor = Supervisor(supervised_devices(config, clock, Beats(clock)))
    await asyncio.to_thread((state / "runs").mkdir, parents=True, exist_ok=True)
    ledger = await asyncio.to_thread(Ledger, state / "ledger.sqlite")
    context = CellContext(config, clock, InlineWorker(), supervisor, MotionBroker(clock), ledger)
    engine = Engine(context, JOBS, state / "runs")
    async with AsyncExitStack() as stack:
        stack.callback(ledger.close)
        for name, entry in supervisor.devices.items():
            stack.push_async_callback(_cancel, asyncio.create_task(entry.run(), name=f"device {name}"))
        stack.push_async_callback(engine.shutdown)
        await _until_ready(supervisor, clock)
        arm: Any = supervisor.ready(config.robot.roles()["arm"])
        if any(step.given_camera for step in steps):
            truth, drawn = arm.world.truth(), config.robot.T_base_camera_nominal
            await asyncio.to_thread(give_camera, ledger, truth, drawn)
        if any(step.given_delay for step in steps):
            camera = config.robot.roles()["fixed_camera"]
            await asyncio.to_thread(give_delay, ledger, camera, arm.world.truth())
        delays = {name: d for step in steps for name, d in step.delays.items()}
        # An encoder's, which may name the camera's version, behind it.
        for device, delay in sorted(delays.items(), key=lambda kept: kept[1].camera_sigma_s is not None):
            await asyncio.to_thread(keep_delay, ledger, device, delay)
        began = clock.now()
        runs = []
        for step in steps:
            run_id = await _run_step(engine, step, arm.world, clock)
            runs.append((run_id, arm.world.truth(clock.now())))
        return runs, clock.now() - began


async def _run_step(engine: Engine, step: Step, world: Any, clock: Clock) -> int:
    """Do to the world what the step says, start its job, and be the operator who confirms."""
    if step.bump is not None:
        world.tool.bend(clock.now(), step.bump.shift_m, (*step.bump.tilt_rad, 0.0))
        say("the tool was bumped")
    if step.held is not None:
        world.operator.move_on(clock.now())
    if step.part_in_hand:
        world.gripper.give(clock.now(), world.rack.hand(clock.now()))
        say("a part was put into the gripper")
    if step.removes_board:
        world.operator.remove(clock.now())
        say("the board was taken away")
    run_id: int = (await engine.start(StartRequest(step.job, step.params, WHO, "demo")))["run_id"]
    placement, finished = 0, False
    asked: Counter[tuple[str, int]] = Counter()
    with ProgressBar() as bar:
        # Not by the whole status: to tell how the devices are, each of them is looked at.
        while (run := engine.running) is not None and run.id == run_id:
            live, taken, prompt = dict(run.live), run.step, run.prompt
            if step.picks and live.get("picks", 0) >= step.picks and not finished:
                finished = True
                await engine.finish(WHO)
            bar.show(f"{step.job}, run {run_id}", taken, run.steps)
            if prompt is not None and asked[prompt[1], taken] == MOST_ASKED:
                await engine.abort(WHO)
            elif prompt is not None:
                asked[prompt[1], taken] += 1
                if step.moves_board:
                    placement = min(placement + 1, world.operator.placements)
                    world.operator.confirm(placement - 1, clock.now())
                    say(f"the operator put the board at place {placement}")
                if step.held is not None:
                    corner, gauge_m, hand_m = live["corner"], step.held.gauge_m, step.held.hand_m
                    there = world.bring_over(clock.now(), int(corner), gauge_m, hand_m)
                    await clock.sleep(there - clock.now())
                await engine.confirm(prompt[0], WHO)
                say("the operator confirmed")
            await clock.sleep(POLL_S)
    return run_id


async def _until_ready(supervisor: Supervisor, clock: Clock) -> None:
    give_up = clock.now() + READY_S
    while waiting := [n for n, d in supervisor.devices.items() if d.state is not DeviceState.READY]:
        if clock.now() > give_up:
            last = supervisor.devices[waiting[0]].last_error
            raise error("DEVICE_NOT_READY", f"{', '.join(waiting)} after {READY_S:g} s: {last}")
        await clock.sleep(POLL_S)


async def _cancel(task: asyncio.Task[None]) -> None:
    task.cancel()
    await asyncio.wait([task], timeout=READY_S)
