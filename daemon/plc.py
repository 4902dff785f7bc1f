"""What a PLC may ask for, and what it can read: the engine seen through the register table."""

import asyncio
import logging
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from functools import cache
from typing import Any

from cell.errors import CellError, RefusedError, error
from cell.formats.result import NO_FIGURES, Figures
from cell.packml import PackML
from daemon.committed_registers import committed_registers
from daemon.config import CellConfig
from daemon.config.roles import ROLES
from daemon.engine import WAITING, Engine
from daemon.job_arguments import PLACES, given_params
from daemon.modbus import Command, register_table
from daemon.recipes import recipes_by_number, with_recipe
from daemon.start_request import StartRequest
from daemon.tools import tools_by_changer
from daemon.warning_bits import WarningContext, warning_bits

log = logging.getLogger("cellward.plc")

ACCEPTED = 1
REFUSED = 0x8000
PROTOCOL_VERSION = 0x0100
COUNTERS = {
    "picks", "misses", "missed_not_detected", "missed_out_of_zone", "missed_lost", "missed_grip_failed",
    "missed_queue_full", "next_place", "place_waits",
}  # fmt: skip
OF_NOW = {
    "belt_speed_m_s", "belt_position_m", "queue_length",
    "target_x_m", "target_y_m", "target_z_m", "target_yaw_rad",
}  # fmt: skip
NOT_AT_WORK = WAITING | {PackML.STOPPING, PackML.ABORTING, PackML.COMPLETING}
SAFETY_ERRORS = {"ARM_PROTECTIVE_STOP", "ARM_EMERGENCY_STOP", "ARM_SAFEGUARD_STOP"}


class PlcFace:
    """Turns commands into calls of the engine, and its state into registers."""

    def __init__(self, config: CellConfig, engine: Engine) -> None:
        self._config, self._engine = config, engine
        self._checksum = config.checksum  # of the whole configuration: too long for every poll
        self._supervisor, self._clock = engine.context.supervisor, engine.context.clock
        self._started = self._clock.now()
        self._acknowledged_run: int | None = None

    async def handle(self, command: Command) -> int:
        """Carry out one command; the result code says accepted, or refused with the error's number."""
        who = f"{command.channel} {command.client}"
        try:
            await self._carry_out(command, who)
        except CellError as refusal:
            log.warning("%s: command %d refused: %s", who, command.code, refusal)
            return REFUSED | refusal.code
        return ACCEPTED

    async def _carry_out(self, command: Command, who: str) -> None:
        engine = self._engine
        match command.code:
            case 1:
                names = {job.number: name for name, job in engine.jobs.items()}
                names |= recipes_by_number(self._config)
                if command.job not in names:
                    raise error("UNKNOWN_JOB", f"number {command.job}")
                asked = StartRequest(names[command.job], {}, who, command.channel, client=command.client)
                job = engine.jobs[with_recipe(self._config, asked).job]
                words = [command.argument_as_uint32(index) for index in range(PLACES)]
                params = given_params(job, words, tools_by_changer(self._config))
                await engine.start(replace(asked, params=params))
            case 2:
                await engine.finish(who)
            case 3:
                await engine.abort(who)
            case 4:
                await engine.halt(who)
            case 5:
                await engine.pause(who)
            case 6:
                await engine.resume(who)
            case 7:
                await engine.reset(who)
            case 8:
                await self._accept(command, who)
            case 9:
                self._acknowledged_run = engine.last["run_id"] if engine.last else None
            case 10:
                await engine.confirm(command.argument_uint32, who)
            case 11:
                await engine.skip(command.argument_uint32, who)
            case _:
                raise error("ARGUMENT_INVALID", f"there is no command {command.code}")

    async def _accept(self, command: Command, who: str) -> None:
        channel = self._config.can if command.channel == "can" else self._config.modbus
        if not channel.allow_accept:
            raise error("NOT_ALLOWED", f"[{command.channel}] allow_accept is false")
        run_id = command.argument_uint32
        waiting = await asyncio.to_thread(self._engine.ledger.open_results_of, run_id)
        if not waiting:
            raise error("NOT_NOW", f"run {run_id} has no result that waits for a decision")
        for result_id in waiting:
            await self._engine.decisions.accept(
                result_id, who, warned=True
            )  # the PLC reads the bit that warns

    def heartbeat_changed(self, alive: bool) -> None:
        """A PLC that went silent holds the job at its next checkpoint; only a person or a PLC resumes it.

        A job whose start is under way is held, too: it begins without anybody who watches it.
        """
        if alive:
            return
        with suppress(RefusedError):  # no job, or one that is just writing its end
            self._engine.hold("the lost heartbeat of the PLC")
            log.warning("the PLC's heartbeat is lost: the job holds")

    def picks_wanted_changed(self, wanted: bool, client: str) -> None:
        """The PLC has set (``False``) or cleared its bit *no new picks*."""
        self._engine.want_work(wanted, f"PLC {client}")

    def snapshot(self) -> dict[str, Any]:
        """The status block by register name.

        A result names its run: once the next one begins, what the last one found is shown no more.
        """
        engine, status = self._engine, self._engine.status()
        last = engine.last if engine.packml in WAITING else None
        if last is not None and last["run_id"] == self._acknowledged_run:
            last = None
        shown = engine.figures if last else NO_FIGURES
        prompt = status["prompt"]
        return {
            "status": self._bits(status, last, shown),
            "packml_state": int(engine.packml),
            "active_job": status["job_number"],
            "error_code": engine.error.code if engine.error else 0,
            "warning_bits": warning_bits(WarningContext(status, last, engine.figures)),
            "protocol_version": PROTOCOL_VERSION,
            "config_checksum": self._checksum,
            "run_id": status["run_id"] or (last["run_id"] if last else 0),
            "step": status["step"],
            "steps": status["steps"],
            "steps_taken_again": status["steps_taken_again"] or (last or {}).get("steps_taken_again", 0),
            "prompt_id": prompt["id"] if prompt else 0,
            "uptime_s": int(self._clock.now() - self._started),
            "spread_within_m": shown.spread_within_m,
            "spread_across_m": shown.spread_across_m,
            **{f"tool_offset_{axis}_m": v for axis, v in zip("xyz", shown.tool_offset_m, strict=True)},
            "tool_tilt_rad": shown.tool_tilt_rad,
            "kinematic_rms_m": shown.kinematic_rms_m,
            "predicted_95_m": shown.predicted_95_m,
            **self._live_registers(status, last),
            **committed_registers(self._config, engine.ledger.versions_now()),
        }

    def _bits(self, status: dict[str, Any], last: dict[str, Any] | None, figures: Figures) -> int:
        engine = self._engine
        waiting = engine.packml in WAITING
        fault = engine.error is not None or status["latched"]
        shown = engine.arm_fault()
        arm = self._ok("arm") and shown is None
        stopped = any(isinstance(e, CellError) and e.name in SAFETY_ERRORS for e in (engine.error, shown))
        bits = {
            "ready": waiting and not status["latched"] and arm,
            "busy": not waiting,
            "done": last is not None and engine.packml is PackML.COMPLETE,
            "fault": fault,
            "warning": bool(last and last.get("verdict") == "warn"),
            "result valid": bool(figures.stands and last and last["verdict"] != "fail"),
            "protective or emergency stop": stopped,
            "twin": self._config.cell.twin,
        }
        usable = {role for role in ROLES if self._ok(role) and not self._stuck(role)}
        if not arm:
            usable.discard("arm")
        names = {name for name, on in bits.items() if on}
        names |= {bit for role in usable if (bit := ROLES[role].status_bit) is not None}
        return sum(map(_mask, names))

    def _live_registers(self, status: Mapping[str, Any], last: Mapping[str, Any] | None) -> dict[str, float]:
        """What a job at work says of now; of one that ends or has ended, in whatever way, its counters."""
        live: Mapping[str, float] = status["live"]
        run = self._engine.run
        if last is not None and run is not None and run.id == last["run_id"]:
            live = run.live
        names = COUNTERS if self._engine.packml in NOT_AT_WORK else COUNTERS | OF_NOW
        return {name: value for name, value in live.items() if name in names}

    def _ok(self, role: str) -> bool:
        name = self._config.robot.roles().get(role)
        return name is not None and self._supervisor.devices[name].state.value == "READY"

    def _stuck(self, role: str) -> bool:
        """Whether the device says that an input has not changed for longer than it should."""
        name = self._config.robot.roles()[role]
        return bool(self._supervisor.devices[name].device.health().get("stuck_s"))


@cache
def _mask(name: str) -> int:
    """Of a bit of the status; looked up once, for the status is made again for every PLC that polls."""
    return register_table().bit("status", name)
