"""Opening each configured device once, to see whether it answers and is the one that is meant."""

import asyncio
import logging
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from cell.clock import MonotonicClock
from cell.devices import Device
from cell.errors import CellError, error
from cell.wire_recording.tap import recorded_by
from cell.wire_recording.writer import WireRecorder
from daemon.cli.failures import exit_code_of
from daemon.composition import supervised_devices
from daemon.config import CellConfig
from daemon.health import Beats
from daemon.supervisor import ExpectedIdentity

OPEN_TIMEOUT_S = 20.0
CLOSE_TIMEOUT_S = 5.0
RECORDED_S = 5.0  # of each device's stream, when it is recorded
_MOST_RECORDED = 500 * 10**6  # bytes


async def probe_devices(config: CellConfig, record: Path | None = None) -> list[dict[str, Any]]:
    """Open, identify and close every device, all at once. Nothing moves: motion needs a lease.

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
        probes = (_probe(entry.device, entry.expect, stay_s) for entry in entries)
        found = list(await asyncio.gather(*probes))
    for report in found:
        report["doubts"] += beyond_its_speed(config, report)
    return found


def beyond_its_speed(config: CellConfig, report: Mapping[str, Any]) -> list[str]:
    """What is said of limits that are above those of the arm's own controller."""
    most, own = config.limits.joint_speed_rad_s, report["joint_speeds_rad_s"]
    if own is None or min(own) >= most:
        return []
    slowest = min(own)
    joints = ", ".join(str(number) for number, speed in enumerate(own, 1) if speed < most)
    return [
        f"limits.joint_speed_rad_s is {most:g} rad/s, and the controller of {report['device']} lets joint"
        f" {joints} turn by {slowest:.3g} rad/s at most: an arm that follows set-points falls behind there;"
        " lower the limit"
    ]


async def _probe(device: Device, expect: ExpectedIdentity, stay_s: float) -> dict[str, Any]:
    report: dict[str, Any] = {
        "device": device.name, "answer": "ok", "model": None, "serial": None, "exit_code": 0, "doubts": [],
        "joint_speeds_rad_s": None,
    }  # fmt: skip
    try:
        try:
            async with asyncio.timeout(OPEN_TIMEOUT_S):
                await device.open()
                found = await device.identify()
                if doubts := getattr(device, "doubts", None):
                    report["doubts"] = await doubts()
            await asyncio.sleep(stay_s)
        finally:
            async with asyncio.timeout(CLOSE_TIMEOUT_S):
                await device.close()
        report |= {"model": found.model, "serial": found.serial}
        report["joint_speeds_rad_s"] = found.extra.get("joint_speeds_rad_s")
        expect.check(device.name, found)
    except CellError as exc:
        _blame(report, exc)
    except (OSError, TimeoutError) as exc:
        _blame(report, error("DEVICE_UNREACHABLE", str(exc) or f"no answer in {OPEN_TIMEOUT_S:g} s"))
    return report


def _blame(report: dict[str, Any], exc: CellError) -> None:
    report |= {"answer": f"{exc} ({exc.code})", "exit_code": exit_code_of(exc), "hint": exc.hint}
