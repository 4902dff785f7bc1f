"""The faces on which the contract of encoders is run: object, a serial CAN adapter, a CAN gateway."""

import asyncio
import time
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest
from wire_faces import Face

from cell.clock import MonotonicClock
from cell.devices import Identity
from cell.testing import EncoderRig
from drivers.can_encoder import CanopenEncoder, CanopenEncoderConfig
from fakes.can import CanFaults, CanWires
from fakes.faults.belt import BeltFaults
from fakes.object import ObjectEncoder, VirtualClock, run_virtual
from fakes.wire.listening import TcpPlace
from fakes.world.scenario import Scenario
from fakes.world.world import World

SCENARIO = "belt:ideal"
HOST = "127.0.51.2"


IDENTITY = Identity("", "999966001")


@asynccontextmanager
async def _object(_: None) -> AsyncIterator[EncoderRig]:
    clock = VirtualClock()
    device = ObjectEncoder("belt", ObjectEncoder.Config(scenario=SCENARIO), clock)

    async def inject(kind: str, **arguments: Any) -> None:
        if "for_s" in arguments:
            arguments["duration_s"] = arguments.pop("for_s")
        device.inject(kind, **arguments)

    await device.open()
    assert device.world.belt is not None
    try:
        yield EncoderRig(device, clock, inject=inject, identity=IDENTITY, belt=device.world.belt)
    finally:
        await device.close()


def _wire(interface: str) -> Callable[[None], AbstractAsyncContextManager[EncoderRig]]:
    @asynccontextmanager
    async def rig(_: None) -> AsyncIterator[EncoderRig]:
        clock = MonotonicClock()
        world = World.from_scenario(Scenario.load(SCENARIO), clock.now())
        encoder, belt = world.encoder, world.belt
        assert encoder is not None
        assert belt is not None
        truth = encoder.truth
        with TemporaryDirectory(prefix="encoder-") as folder:
            wires = CanWires(
                encoder,
                truth.node,
                int(truth.serial),
                time.monotonic,
                Path(folder) / "can.tty" if interface == "slcan" else None,
                TcpPlace(HOST, 0) if interface == "socketcand" else None,
            )
            of_shaft = BeltFaults(encoder, time.monotonic)
            faults = CanFaults(wires, of_shaft)
            await wires.start()
            config = CanopenEncoderConfig(
                bus=wires.buses[interface],
                node=truth.node,
                period_s=truth.period_s,
                connect_timeout_s=2.0,
                lost_after_s=1.0,  # a busy machine may keep the frames of half a second back
            )
            device = CanopenEncoder("belt", config, clock)

            async def inject(kind: str, **arguments: Any) -> None:
                offered = {fault.value: fault for fault in faults.offers()}
                faults.clear() if kind == "clear" else faults.inject(offered[kind], arguments)

            try:
                await device.open()
                yield EncoderRig(device, clock, inject=inject, identity=IDENTITY, belt=belt)
            finally:
                await device.close()
                faults.close()
                of_shaft.close()
                await wires.stop()
                await asyncio.sleep(0)

    return rig


def encoder_faces() -> list[Any]:
    """Parameters for a fixture."""
    wires = [
        pytest.param(Face(name, asyncio.run, _wire(name), wire=True), id=name, marks=pytest.mark.wire)
        for name in ("slcan", "socketcand")
    ]
    return [pytest.param(Face("object", run_virtual, _object), id="object"), *wires]
