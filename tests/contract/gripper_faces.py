"""The faces on which the contract of grippers is run: object, an arm's outputs, a module's, and a Robotiq."""

import asyncio
import os
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest

from cell.clock import MonotonicClock
from cell.testing import Bench, GripperRig
from drivers.grippers import ModbusGripper, RobotiqGripper
from fakes.faults.vocabulary import Faulty
from fakes.object import ObjectGripper, VirtualClock, run_virtual
from fakes.twin.gripper import TwinGripper
from fakes.world.belt.gripper import Gripper as WorldGripper
from fakes.world.belt.item_truth import GripperTruth
from fakes.world.scenario import FakeAddresses
from tests.kit.one_item import NO_ITEM, POINT, Thing, one_item_under_the_tool

HOST, PORT = f"127.0.22.{100 + int(os.environ.get('PYTEST_XDIST_WORKER', 'gw0')[2:])}", 5506
DRIVERS: dict[str, Any] = {"modbus-gripper": ModbusGripper, "robotiq": RobotiqGripper}


@asynccontextmanager
async def _object(counts_after_s: float | None = None, part: bool = False) -> AsyncIterator[GripperRig]:
    clock = VirtualClock()
    with TemporaryDirectory(prefix="gripper-") as folder:
        scenario = Path(folder) / "scenario.toml"
        scenario.write_text(one_item_under_the_tool() if part else NO_ITEM, "utf-8")
        config = ObjectGripper.Config(scenario=str(scenario), counts_after_s=counts_after_s)
        device = ObjectGripper("gripper", config, clock)

        async def inject(kind: str, **arguments: Any) -> None:
            device.plant.inject(kind, arguments)

        await device.open()
        await clock.sleep(0.1)
        try:
            yield GripperRig(device, clock, inject=inject, identity=await device.identify())
        finally:
            await device.close()


@asynccontextmanager
async def _wire(by: str, part: bool = False) -> AsyncIterator[GripperRig]:
    clock = MonotonicClock()
    world = WorldGripper(GripperTruth(close_s=0.15, open_s=0.1), Thing(part), lambda t: POINT)
    with TemporaryDirectory(prefix="gripper-") as folder:
        addresses = FakeAddresses(gripper_by=by, gripper_port=PORT)  # type: ignore[arg-type]
        twin = TwinGripper(world, addresses, HOST, Path(folder))
        await twin.start()
        table = {"timeout_s": 1.0} | twin.device()
        driver = DRIVERS[table.pop("driver")]
        device = driver("gripper", driver.Config(**table), clock)
        try:
            await device.open()
            found = await device.identify()
            yield GripperRig(device, clock, inject=_injecting(twin.faults), identity=found)
        finally:
            await device.close()
            await twin.stop()


def _injecting(faults: Faulty) -> Callable[..., Any]:
    async def inject(kind: str, **arguments: Any) -> None:
        offered = {fault.value: fault for fault in faults.offers()}
        faults.clear() if kind == "clear" else faults.inject(offered[kind], arguments)

    return inject


def gripper_faces() -> list[Any]:
    """Parameters for a fixture. A gripper on an arm's outputs has tests of its own."""
    found = [
        pytest.param(Bench(_object, run_virtual), id="object"),
        pytest.param(Bench(partial(_object, counts_after_s=0.5), run_virtual), id="object-unconfirmed"),
    ]
    for by in ("modbus", "robotiq-rtu", "robotiq-urcap"):
        bench = Bench(partial(_wire, by), asyncio.run, retried=True)
        found.append(pytest.param(bench, id=by, marks=pytest.mark.wire))
    return found
