"""The daemon put together: configuration in, everything built, watched, and taken down in order."""

import asyncio
import logging
import signal
from collections.abc import Coroutine
from contextlib import AsyncExitStack
from pathlib import Path
from typing import Any

from cell.clock import Clock, MonotonicClock
from cell.devices import Device
from cell.motion import MotionBroker
from cell.store.ledger import Ledger
from cell.store.runs import interrupted_runs
from daemon.config import CellConfig, driver_class, load_config
from daemon.control import ControlServer

from daemon.engine import CellContext, Engine
from daemon.health import Beats, LoopLag, watchdog
from daemon.logs import set_up_logging
from daemon.modbus import ModbusFace
from daemon.notify import Notifier
from daemon.plc import PlcFace
from daemon.supervisor import Expectation, SupervisedDevice, Supervisor
from daemon.worker import ProcessWorker
from procedures.registry import JOBS

log = logging.getLogger("cellward")


def main(config_path: Path) -> int:
    """Run the daemon until SIGTERM or SIGINT; returns the exit code."""
    config = load_config(config_path)
    set_up_logging()
    asyncio.run(serve(config))
    return 0


async def serve(config: CellConfig, stop: asyncio.Event | None = None) -> None:
    """Build the cell, say READY, and serve until ``stop`` or a signal.

    READY means that config, ledger and control socket are up; devices may still be retrying.
    """
    stop = stop or _stop_on_signal()
    clock = MonotonicClock()
    notifier = Notifier()
    beats, lag = Beats(clock), LoopLag(clock)
    state = Path(config.cell.state_dir)
    runs = state / "runs"
    await asyncio.to_thread(runs.mkdir, parents=True, exist_ok=True)
    ledger = await asyncio.to_thread(Ledger, state / "ledger.sqlite")
    supervisor = Supervisor(_supervised(config, clock, beats))
    worker = ProcessWorker()
    context = CellContext(config, clock, worker, supervisor, MotionBroker(clock))
    engine = Engine(context, ledger, JOBS, runs)
    await _report_interrupted(engine, ledger, runs)

    async with AsyncExitStack() as stack, asyncio.TaskGroup() as tasks:
        stack.callback(ledger.close)

        def spawn(name: str, work: Coroutine[Any, Any, Any]) -> None:
            running.append(tasks.create_task(work, name=name))

        running: list[asyncio.Task[Any]] = []
        try:
            log.info("cellward for cell '%s', config %s", config.cell.name, config.source)
            spawn("loop lag", lag.watch(beats, config.supervisor.loop_lag_warn_s))
            for name, entry in supervisor.devices.items():
                spawn(f"device {name}", entry.run())
            await worker.start()
            control = ControlServer(Path(config.cell.control_socket), engine)
            await control.start()
            plc = PlcFace(config, engine, supervisor, ledger, clock)
            modbus = ModbusFace(config.modbus, clock, plc.handle, plc.snapshot, audit=plc.audit)
            await modbus.start()
            notifier.ready()
            spawn("watchdog", watchdog(beats, lag, config.supervisor.loop_lag_fail_s, 0.5, notifier.send))
            await stop.wait()
            notifier.stopping()
            log.info("stopping")
            await modbus.stop()
            await engine.shutdown()
            await control.stop()
        finally:
            await engine.shutdown()
            for task in running:
                task.cancel()
            await worker.stop()


def _supervised(config: CellConfig, clock: Clock, beats: Beats) -> list[SupervisedDevice]:
    """One supervised device a ``[device.NAME]`` section, not yet connected."""
    made = []
    for name, section in config.device.items():
        device: Device = driver_class(section.driver)(name, section, clock)
        serial = getattr(section, "expect_serial", None)
        made.append(SupervisedDevice(device, Expectation(config.cell.twin, serial), clock, beats))
    return made


async def _report_interrupted(engine: Engine, ledger: Ledger, runs: Path) -> None:
    """Runs without an end: say so, and write the end that the killed daemon could not."""
    for run in await asyncio.to_thread(interrupted_runs, runs):
        log.warning(
            "run %d (%s) was interrupted; nothing moves by itself. 'cellward adopt %d' takes it up again",
            run.run_id, run.job, run.run_id,
        )  # fmt: skip
        await asyncio.to_thread(run.mark_interrupted)
        ledger.end_run(run.run_id, "interrupted", None)
        engine.interrupted.append(run.run_id)


def _stop_on_signal() -> asyncio.Event:
    stop = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, stop.set)
    return stop
