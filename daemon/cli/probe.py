"""Opening each configured device once, to see whether it answers and is the one that is meant."""

import asyncio
from typing import Any

from cell.clock import Clock, MonotonicClock
from cell.devices import Device
from cell.errors import CellError, error
from daemon.cli.failures import exit_code_of
from daemon.config import CellConfig, driver_class
from daemon.supervisor import Expectation

OPEN_TIMEOUT_S = 20.0
CLOSE_TIMEOUT_S = 5.0


async def probe_devices(config: CellConfig) -> list[dict[str, Any]]:
    """Open, identify and close every device, all at once. Nothing moves: motion needs a lease."""
    clock = MonotonicClock()
    return list(
        await asyncio.gather(
            *(_probe(config, name, section, clock) for name, section in config.device.items())
        )
    )


async def _probe(config: CellConfig, name: str, section: Any, clock: Clock) -> dict[str, Any]:
    report: dict[str, Any] = {"device": name, "answer": "ok", "model": None, "serial": None, "exit_code": 0}
    try:
        device: Device = driver_class(section.driver)(name, section, clock)
        try:
            async with asyncio.timeout(OPEN_TIMEOUT_S):
                await device.open()
                found = await device.identify()
        finally:
            async with asyncio.timeout(CLOSE_TIMEOUT_S):
                await device.close()
        report |= {"model": found.model, "serial": found.serial}
        Expectation(config.cell.twin, getattr(section, "expect_serial", None)).check(name, found)
    except CellError as exc:
        _blame(report, exc)
    except (OSError, TimeoutError) as exc:
        _blame(report, error("DEVICE_UNREACHABLE", str(exc) or f"no answer in {OPEN_TIMEOUT_S:g} s"))
    return report


def _blame(report: dict[str, Any], exc: CellError) -> None:
    report |= {"answer": f"{exc} ({exc.code})", "exit_code": exit_code_of(exc), "hint": exc.hint}
