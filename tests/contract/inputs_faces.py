"""The faces on which the contract of digital inputs is run: object, Modbus TCP, Modbus on a serial line."""

import asyncio
import importlib.util
import time
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest
from wire_faces import Face

from cell.clock import MonotonicClock
from cell.devices import Identity as DeviceIdentity
from cell.testing import InputsRig
from drivers.modbus_inputs import InputsConfig, ModbusInputs
from fakes.faults.inputs import InputFaults
from fakes.modbus_io import Identity, Module, ModuleFaults, ModuleWires, TcpPlace, register_map
from fakes.object import ObjectInputs, VirtualClock, run_virtual
from fakes.world.scenario import Scenario
from fakes.world.world import World

SCENARIO = "laser:ideal"  # an ioLogik E1210 with the beams xs and ys at inputs 0 and 1, both free
HOST = "127.0.21.2"
PERIOD = {"tcp": 0.005, "rtu": 0.02}
FAULTS_OF_LINKS = {"refuse", "drop", "reset"}


IDENTITY = DeviceIdentity("ioLogik-E1210", "99993300001")


@asynccontextmanager
async def _object(_: None) -> AsyncIterator[InputsRig]:
    clock = VirtualClock()
    device = ObjectInputs("beams", ObjectInputs.Config(scenario=SCENARIO), clock)

    async def inject(kind: str, **arguments: Any) -> None:
        device.inject(kind, **arguments)

    async def lose_polls() -> None:
        device.inject("gap", count=4)

    await device.open()
    try:
        yield InputsRig(
            device,
            clock,
            inject=inject,
            identity=IDENTITY,
            lose_polls=lose_polls,
            period_s=device.config.poll_period_s,
        )
    finally:
        await device.close()


def _wire(scheme: str) -> Callable[[None], AbstractAsyncContextManager[InputsRig]]:
    @asynccontextmanager
    async def rig(_: None) -> AsyncIterator[InputsRig]:
        clock = MonotonicClock()
        inputs = World.from_scenario(Scenario.load(SCENARIO), clock.now()).inputs
        assert inputs is not None
        truth = inputs.truth
        module = Module(
            inputs, register_map(truth.module), Identity(truth.module, truth.serial), time.monotonic
        )
        with TemporaryDirectory(prefix="inputs-") as folder:
            line = Path(folder) / "io.tty"
            wires = ModuleWires(module, (TcpPlace(HOST, 0),), line)
            of_inputs = InputFaults(inputs, time.monotonic)
            faults = ModuleFaults(wires, of_inputs)
            await wires.start()
            host, port = wires.addresses[0]
            device = ModbusInputs(
                "beams",
                InputsConfig(
                    url=f"tcp://{host}:{port}" if scheme == "tcp" else f"rtu://{line}",
                    module=truth.module,
                    poll_period_s=PERIOD[scheme],
                    timeout_s=0.1,
                    inputs={name: {"address": channel} for name, channel in truth.inputs.items()},  # type: ignore[misc]
                ),
                clock,
            )

            async def inject(kind: str, **arguments: Any) -> None:
                offered = {fault.value: fault for fault in faults.offers()}
                faults.clear() if kind == "clear" else faults.inject(offered[kind], arguments)

            async def lose_polls() -> None:
                await inject("delay", s=2.5 * PERIOD[scheme])
                await clock.sleep(8 * PERIOD[scheme])
                await inject("delay", s=0.0)

            try:
                await device.open()
                yield InputsRig(
                    device,
                    clock,
                    inject=inject,
                    identity=IDENTITY,
                    lose_polls=lose_polls,
                    period_s=PERIOD[scheme],
                )
            finally:
                await device.close()
                faults.close()
                of_inputs.close()
                await wires.stop()
                await asyncio.sleep(0)

    return rig


_NO_PYSERIAL = pytest.mark.skipif(
    importlib.util.find_spec("serial") is None, reason="pyserial is not installed (pip install pyserial)"
)


def inputs_faces() -> list[Any]:
    """Parameters for a fixture."""
    serial = Face("rtu", asyncio.run, _wire("rtu"), wire=True, lacks=frozenset(FAULTS_OF_LINKS))
    return [
        pytest.param(Face("object", run_virtual, _object), id="object"),
        pytest.param(Face("tcp", asyncio.run, _wire("tcp"), wire=True), id="tcp", marks=pytest.mark.wire),
        pytest.param(serial, id="rtu", marks=[pytest.mark.wire, _NO_PYSERIAL]),
    ]
