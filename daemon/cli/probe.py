"""Opening each configured device once, to see whether it answers and is the one that is meant."""

import asyncio
import logging
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

from cell.clock import MonotonicClock
from cell.devices import Device
from cell.errors import CellError, error
from cell.wire_recording.tap import recorded_by
from cell.wire_recording.writer import WireRecorder
from daemon.cli.failures import exit_code_of
from daemon.composition import bound_to, supervised_devices
from daemon.config import CellConfig
from daemon.controller_limits import beyond, narrower_than_planned
from daemon.health import Beats
from daemon.job_config import make_procedure
from daemon.recipes import place_of
from daemon.supervisor import ExpectedIdentity
from daemon.values import beyond_controller, configured_values
from procedures.registry import JOBS

OPEN_TIMEOUT_S = 20.0
CLOSE_TIMEOUT_S = 5.0
RECORDED_S = 5.0  # of each device's stream, when it is recorded
_MOST_RECORDED = 500 * 10**6  # bytes


async def probe_devices(config: CellConfig, record: Path | None = None) -> list[dict[str, Any]]:
    """Open, identify and close every device, all at once. Nothing moves: motion needs a lease.

    A device that stands on another one, as a gripper on an arm's outputs, is opened after it. All stay open
    until each has been asked.

    ``record``: a folder that gets every byte, also of the ``RECORDED_S`` that the devices then stay open.
    """
    # pymodbus dumps frames when something that is not Modbus answers; what is wrong is told by the report.
    logging.getLogger("pymodbus").setLevel(logging.CRITICAL)
    clock = MonotonicClock()
    with ExitStack() as stack:
        stay_s = 0.0
        if record is not None:
            recorder = await asyncio.to_thread(WireRecorder, record, _MOST_RECORDED)
            stack.callback(recorder.close)
            stack.enter_context(recorded_by(recorder))
            stay_s = RECORDED_S
        entries = supervised_devices(config, clock, Beats(clock))
        order = _Order(config)
        probes = (_probe(entry.device, entry.expect, stay_s, order) for entry in entries)
        found = list(await asyncio.gather(*probes))
    for report in found:
        if report["device"] == config.robot.roles().get("arm"):
            judge_limits(config, report)
    return found


def judge_limits(config: CellConfig, report: dict[str, Any]) -> None:
    """Add to the report of the arm what its controller's own limits say of ``[limits]``, and of those that a
    job or a recipe brings of its own, as its start would refuse them."""
    report["doubts"] += narrower_than_planned(config, report)
    if report["exit_code"]:
        return
    values = configured_values(config)
    found = dict.fromkeys(beyond(values.limits, report))  # each once, though jobs share [limits]
    starts: list[tuple[str, str, dict[str, Any]]]
    starts = [(name, "", {}) for name in JOBS if config.job_section(name)]
    starts += [(recipe.job, name, recipe.parameters) for name, recipe in config.recipe.items()]
    for job, recipe, parameters in starts:
        place = place_of(config, recipe, job, "limits")
        with suppress(CellError):  # a finding of the check itself
            procedure = make_procedure(JOBS[job], config, {}, parameters)
            found |= dict.fromkeys(beyond_controller(values, procedure, report, place))
    if found:
        _blame(report, error("LIMITS_BEYOND_CONTROLLER", "; ".join(found)))


class _Order:
    """A device is opened after those that it stands on were asked; none that answers is closed before all
    were."""

    def __init__(self, config: CellConfig) -> None:
        self._config = config
        self._asked = {name: asyncio.Event() for name in config.device}

    async def turn(self, name: str) -> None:
        for other in bound_to(self._config, name).values():
            await self._asked[other].wait()

    def asked(self, name: str) -> None:
        """Also when it gave no answer."""
        self._asked[name].set()

    async def all_asked(self) -> None:
        for asked in self._asked.values():
            await asked.wait()


async def _probe(device: Device, expect: ExpectedIdentity, stay_s: float, order: _Order) -> dict[str, Any]:
    report: dict[str, Any] = {
        "device": device.name, "answer": "ok", "model": None, "serial": None, "exit_code": 0, "doubts": [],
        "joint_speeds_rad_s": None, "joint_ranges_rad": None,
    }  # fmt: skip
    try:
        try:
            await order.turn(device.name)
            async with asyncio.timeout(OPEN_TIMEOUT_S):
                await device.open()
                found = await device.identify()
                if doubts := getattr(device, "doubts", None):
                    report["doubts"] = await doubts()
            order.asked(device.name)
            await order.all_asked()
            await asyncio.sleep(stay_s)
        finally:
            order.asked(device.name)
            async with asyncio.timeout(CLOSE_TIMEOUT_S):
                await device.close()
        report |= {"model": found.model, "serial": found.serial}
        report |= {key: found.extra.get(key) for key in ("joint_speeds_rad_s", "joint_ranges_rad")}
        expect.check(device.name, found)
    except CellError as exc:
        _blame(report, exc)
    except (OSError, TimeoutError) as exc:
        _blame(report, error("DEVICE_UNREACHABLE", str(exc) or f"no answer in {OPEN_TIMEOUT_S:g} s"))
    return report


def _blame(report: dict[str, Any], exc: CellError) -> None:
    report |= {"answer": f"{exc} ({exc.code})", "exit_code": exit_code_of(exc), "hint": exc.hint}
