"""The daemon put together: configuration in, everything built, watched, and taken down in order."""

import asyncio
import logging
import signal
from collections.abc import Coroutine
from concurrent.futures import ThreadPoolExecutor
from contextlib import AsyncExitStack
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cell.clock import MonotonicClock
from cell.errors import CellError
from cell.motion import MotionBroker
from cell.store.ledger import Ledger
from cell.version import software
from cell.wire_recording.tap import recorded_by
from daemon.cell_context import CellContext
from daemon.check_due import CheckDue
from daemon.collector import collect_at_rest, freeze_start_up
from daemon.composition import supervised_devices
from daemon.config import CellConfig, load_config
from daemon.control import ControlServer
from daemon.disk_space import DiskSpace, low_limit
from daemon.engine import Engine
from daemon.health import Beats, LoopLag, watchdog
from daemon.log_lines import RecentLog
from daemon.logs import set_up_logging
from daemon.modbus import ModbusFace
from daemon.notify import Notifier
from daemon.plc import PlcFace
from daemon.recent_writes import RecentWrites
from daemon.report_drawing import ReportDrawing
from daemon.results import reject_left_open
from daemon.spare_worker import SpareWorker
from daemon.state_folder import claimed, damage_text, end_interrupted, make_state_folder
from daemon.supervisor import Supervisor
from daemon.worker import ProcessWorker
from procedures.registry import JOBS

if TYPE_CHECKING:
    from daemon.can.face import CanFace
    from daemon.web.server import WebServer

log = logging.getLogger("cellward")

SEQUENCE_KEY = "modbus.acknowledged_sequence"
CAN_SEQUENCE_KEY = "can.acknowledged_sequence"
WATCHDOG_PERIOD_S = 1.0
# What waits for the ledger, locked by another program for instance, waits in these: the records of a run need
# one, too, and must not stand behind it. Without this there are six on two cores.
DISK_THREADS = 64


def main(config_path: Path) -> int:
    """Run the daemon until SIGTERM or SIGINT; returns the exit code."""
    config = load_config(config_path)
    set_up_logging()
    worker = ProcessWorker()
    worker.fork()
    asyncio.run(_until_signal(config, worker))
    return 0


async def _until_signal(config: CellConfig, worker: ProcessWorker) -> None:
    stop = asyncio.Event()
    loop = asyncio.get_running_loop()
    loop.set_default_executor(ThreadPoolExecutor(DISK_THREADS, "disk"))
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, stop.set)
    await serve(config, stop, worker)


async def serve(config: CellConfig, stop: asyncio.Event, worker: ProcessWorker) -> None:
    """Build the cell, say READY, and serve until ``stop``.

    READY means that config, ledger and control socket are up; devices may still be retrying. A task that
    must not end and does takes the daemon down, after its arm has come to rest.
    """
    if config.http.enabled:  # before anything runs that its import would hold up
        import daemon.web.views  # noqa: F401
    clock = MonotonicClock()
    state = Path(config.cell.state_dir)
    log.info("%s, cell '%s', config %s, state in %s", software(), config.cell.name, config.source, state)
    for warning in config.warnings:
        log.warning("%s", warning)
    async with AsyncExitStack() as stack:
        notifier = Notifier()
        stack.callback(notifier.close)
        await asyncio.to_thread(make_state_folder, state)
        stack.enter_context(claimed(state))
        ledger = await asyncio.to_thread(Ledger, state / "ledger.sqlite")
        stack.callback(ledger.close)
        if (damage := ledger.damage()) is not None:
            log.error("%s. 'cellward acknowledge-ledger' ends this message", damage_text(damage))
        stack.push_async_callback(worker.stop)
        await worker.start()

        if config.cell.record:
            await _record(config, stack)
        beats, lag = Beats(clock), LoopLag(clock)
        supervisor = Supervisor(supervised_devices(config, clock, beats))
        broker = MotionBroker(clock)
        context = CellContext(
            config, clock, worker, supervisor, broker, ledger, lag.longest_since, lag.count_into
        )
        engine = Engine(context, JOBS, state / "runs")
        engine.loop_lag = lag.summary
        disk = DiskSpace(state, clock, low_limit(config))
        engine.disk = disk.status
        check_due = CheckDue(config, ledger, JOBS, clock)
        engine.due = check_due.status
        drawing = ReportDrawing()
        engine.report_wanted = drawing.want
        await _report_interrupted(engine, ledger)

        essential: list[asyncio.Task[Any]] = []
        stack.push_async_callback(_end, essential)

        def spawn(name: str, work: Coroutine[Any, Any, Any]) -> None:
            essential.append(asyncio.create_task(work, name=name))

        spawn("disk space", disk.watch())
        if check_due.wanted:
            spawn("calibrations due", check_due.watch())
        spawn("drawing of reports", drawing.run())
        spawn("loop lag", lag.watch(beats, config.supervisor.loop_lag_warn_s))
        for name, entry in supervisor.devices.items():
            spawn(f"device {name}", entry.run())
        stack.push_async_callback(engine.shutdown)
        writes = RecentWrites(ledger)
        plc = PlcFace(config, engine)
        modbus = _modbus(config, engine, plc, writes) if config.modbus.enabled else None
        if modbus is not None:
            await modbus.start()
            stack.push_async_callback(modbus.stop)
        if config.can.enabled:
            trigger = _can(config, engine, plc, writes)
            await trigger.start()
            stack.push_async_callback(trigger.stop)
        control = ControlServer(Path(config.cell.control_socket), engine, writes.audit("control"))
        await control.start()
        stack.push_async_callback(control.stop)
        if config.http.enabled:
            spare = SpareWorker()
            stack.push_async_callback(spare.stop)
            page = _page(engine, plc, writes, modbus, stack.enter_context(RecentLog()), spare)
            await page.start()
            stack.push_async_callback(page.stop)
        if config.mqtt.enabled:
            from daemon.mqtt.publisher import Publisher

            spawn("mqtt", Publisher(config.mqtt, engine, config.cell.name, state).run())
        freeze_start_up()
        spawn("collector", collect_at_rest(lambda: engine.active))
        notifier.ready(f"cell '{config.cell.name}'")
        period = notifier.watchdog_s / 2 if notifier.watchdog_s else WATCHDOG_PERIOD_S
        spawn("watchdog", watchdog(beats, lag, config.supervisor.loop_lag_fail_s, period, notifier.watchdog))

        spawn("stop", stop.wait())
        ended, _ = await asyncio.wait(essential, return_when=asyncio.FIRST_COMPLETED)
        notifier.stopping()
        for task in ended:
            if task.get_name() != "stop":
                log.critical("the task '%s' ended, so the daemon does", task.get_name())
                task.result()
        log.info("stopping")


async def _record(config: CellConfig, stack: AsyncExitStack) -> None:
    """Keep every byte of the devices from now on; a new folder for each start of the daemon."""
    from cell.wire_recording.writer import WireRecorder

    recordings = Path(config.cell.state_dir) / "recordings"
    folder = recordings / datetime.now(UTC).strftime("%Y%m%dT%H%M%S.%fZ")
    limit = config.cell.record_mb * 10**6
    recorder = await asyncio.to_thread(WireRecorder, folder, limit, recordings)
    stack.push_async_callback(asyncio.to_thread, recorder.close)
    stack.enter_context(recorded_by(recorder))
    log.info("every byte of the devices is recorded in %s, at most %d MB", folder, config.cell.record_mb)


def _can(config: CellConfig, engine: Engine, plc: PlcFace, writes: RecentWrites) -> "CanFace":
    """Commands over CAN; a cell without a bus need not import what speaks on it."""
    from daemon.can.face import CanFace

    ledger = engine.ledger
    return CanFace(
        config.can,
        engine.context.clock,
        plc.handle,
        plc.snapshot,
        audit=writes.audit("can"),
        on_plc=plc.heartbeat_changed,
        last_sequence=ledger.get_state(CAN_SEQUENCE_KEY, 0),
        remember=lambda sequence: ledger.set_state(CAN_SEQUENCE_KEY, sequence),
    )


def _modbus(config: CellConfig, engine: Engine, plc: PlcFace, writes: RecentWrites) -> ModbusFace:
    ledger = engine.ledger
    return ModbusFace(
        config.modbus,
        engine.context.clock,
        plc.handle,
        plc.snapshot,
        audit=writes.audit("modbus"),
        on_plc=plc.heartbeat_changed,
        on_picks=plc.picks_wanted_changed,
        last_sequence=ledger.get_state(SEQUENCE_KEY, 0),
        remember=lambda sequence: ledger.set_state(SEQUENCE_KEY, sequence),
    )


def _page(
    engine: Engine,
    plc: PlcFace,
    writes: RecentWrites,
    modbus: ModbusFace | None,
    recent: RecentLog,
    spare: SpareWorker,
) -> "WebServer":
    """The operator's page; a cell without one need not import what serves it."""
    from daemon.web.server import WebServer
    from daemon.web.state import PageState
    from daemon.web.views import views

    def plc_alive() -> bool | None:
        return modbus.plc_alive if modbus is not None and modbus.plc_heard else None

    config = engine.context.config
    states = PageState(engine, writes, plc_alive)
    more = views(engine, plc, writes, recent, spare)
    return WebServer(config.http, engine, states, writes.audit("web"), more)


async def _report_interrupted(engine: Engine, ledger: Ledger) -> None:
    """Runs without an end get one, and are told; a disk that refuses it keeps the daemon from nothing."""
    engine.interrupted += await asyncio.to_thread(end_interrupted, engine.runs, ledger)
    try:
        await asyncio.to_thread(reject_left_open, ledger, engine.jobs)
    except CellError as exc:
        log.error("results that interrupted runs left open cannot be rejected: %s", exc)
    await engine.decisions.look()


async def _end(tasks: list[asyncio.Task[Any]]) -> None:
    for task in tasks:
        task.cancel()
    await asyncio.wait(tasks)
