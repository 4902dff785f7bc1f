"""The contract of an observed arm with a handshake, on the object face and over Modbus registers."""

import asyncio
import tempfile
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from cell.devices import Identity
from cell.testing import Bench, ObservedArmContract, ObservedArmRig
from fakes.object import ObjectObservedArm, VirtualClock, run_virtual
from tests.kit.observed_rig import CLOCK, palletizer, reader

OF_THE_ARM: dict[str, Any] = {
    "identity": Identity("", "99995500001"),
    "home": [0.0, 1.570796, -1.570796, 0.0],
    "there": [0.2, 1.45, -1.45, 0.1],
    "beyond": [0.0, 3.0, -1.0, 0.0],
}


@asynccontextmanager
async def on_object(allow: bool = True) -> AsyncIterator[ObservedArmRig]:
    clock = VirtualClock()
    config = ObjectObservedArm.Config(scenario="palletizer:ideal", allow_requests=allow)
    device = ObjectObservedArm("palletizer", config, clock)

    async def inject(kind: str, **arguments: Any) -> None:
        device.inject(kind, **arguments)

    await device.open()
    await device.wait_fresh(2.0)
    try:
        yield ObservedArmRig(device, clock, inject=inject, **OF_THE_ARM)
    finally:
        await device.close()


@asynccontextmanager
async def on_the_wire(allow: bool = True) -> AsyncIterator[ObservedArmRig]:
    with tempfile.TemporaryDirectory(prefix="observed-") as folder:
        async with palletizer(Path(folder)) as (twin, _, board):
            device = reader(twin.device(), allow_requests=allow)

            async def inject(kind: str, **arguments: Any) -> None:
                board.inject("palletizer", kind, arguments)

            await device.open()
            try:
                yield ObservedArmRig(device, CLOCK, inject=inject, **OF_THE_ARM)
            finally:
                await device.close()


class TestObservedArm(ObservedArmContract):
    @pytest.fixture(
        params=[
            pytest.param(Bench(on_object, run_virtual), id="object"),
            pytest.param(Bench(on_the_wire, asyncio.run), id="tcp", marks=pytest.mark.wire),
        ]
    )
    def subject(self, request: pytest.FixtureRequest) -> Bench[ObservedArmRig]:
        return request.param
