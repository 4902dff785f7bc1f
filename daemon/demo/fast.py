"""The fast demo: the same job in this process, on a world without protocols and a clock without waiting.

Its configuration names drivers and a clock as ``package.module:Class``; that name is all this code knows of
them. The clock's module offers ``run_virtual``, which runs a coroutine on the loop that makes the clock jump.
"""

import asyncio
import importlib
import logging
import time
from contextlib import AsyncExitStack
from importlib.resources import files
from pathlib import Path
from typing import Any

from cell.clock import Clock
from cell.devices import DeviceState
from cell.errors import error
from cell.motion import MotionBroker
from cell.store.ledger import Ledger
from daemon.cli.output import out, say
from daemon.cli.progress import ProgressBar
from daemon.composition import supervised_devices
from daemon.config import CellConfig, load_config
from daemon.demo.ending import conclude
from daemon.engine import CellContext, Engine
from daemon.health import Beats
from daemon.supervisor import Supervisor
from daemon.worker import InlineWorker
from procedures.registry import JOBS

JOB = "cone-capture"
READY_S = 30.0
POLL_S = 0.1
WHO = "the demo"


def run_fast(folder: Path) -> int:
    """Run the demo with its files in ``folder``; the exit code is that of the full one."""
    out(f"Cellward demo, fast: {JOB} in one process. ETA under a minute.")
    out("Arm, camera and clock are virtual objects here: no process, no protocol and no Modbus is exercised.")
    folder.mkdir(parents=True, exist_ok=True)
    logging.basicConfig(filename=folder / "fast.log", level=logging.INFO, force=True)
    config = load_config(_write_config(folder))
    assert config.cell.clock is not None
    module, _, name = config.cell.clock.partition(":")
    virtual = importlib.import_module(module)
    began = time.monotonic()
    run_id, truth, seconds = virtual.run_virtual(_run(config, getattr(virtual, name)()))
    say(
        f"The log is {folder / 'fast.log'}. {seconds:.0f} s of the cell took {time.monotonic() - began:.1f} s"
    )
    return conclude(Path(config.cell.state_dir) / "runs", run_id, truth)


def _write_config(folder: Path) -> Path:
    text = files("daemon.demo").joinpath("fast.toml").read_text("utf-8")
    path = folder / "fast.toml"
    path.write_text(text.replace("@FOLDER@", str(folder)), "utf-8")
    return path


async def _run(config: CellConfig, clock: Clock) -> tuple[int, dict[str, Any], float]:
    """The number of the run, the truth, and how long it took on the cell's clock."""
    state = Path(config.cell.state_dir)
    supervisor = Supervisor(supervised_devices(config, clock, Beats(clock)))
    await asyncio.to_thread((state / "runs").mkdir, parents=True, exist_ok=True)
    ledger = await asyncio.to_thread(Ledger, state / "ledger.sqlite")
    context = CellContext(config, clock, InlineWorker(), supervisor, MotionBroker(clock))
    engine = Engine(context, ledger, JOBS, state / "runs")
    async with AsyncExitStack() as stack:
        stack.callback(ledger.close)
        for name, entry in supervisor.devices.items():
            stack.push_async_callback(_cancel, asyncio.create_task(entry.run(), name=f"device {name}"))
        stack.push_async_callback(engine.shutdown)
        await _until_ready(supervisor, clock)
        arm: Any = supervisor.ready(config.robot.roles()["arm"])
        began = clock.now()
        run_id = await _run_job(engine, arm.world.operator, clock)
        return run_id, arm.world.truth(), clock.now() - began


async def _run_job(engine: Engine, operator: Any, clock: Clock) -> int:
    """Start the job, and be the operator who moves the board and confirms."""
    run_id: int = (await engine.start(JOB, {}, who=WHO, channel="demo"))["run_id"]
    placement = 0
    with ProgressBar() as bar:
        while (status := engine.status())["run_id"] == run_id:
            bar.show(f"run {run_id}, placement {placement + 1}", status["step"], status["steps"])
            if status["prompt"] is not None:
                placement += 1
                operator.confirm(placement, clock.now())
                await engine.confirm(status["prompt"]["id"], WHO)
                say(f"the operator moved the board to place {placement + 1} and confirmed")
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
