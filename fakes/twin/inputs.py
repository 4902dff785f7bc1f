"""The input module of a twin: the world's inputs on their wires, and what a daemon must know to read them."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from fakes.faults.inputs import InputFaults
from fakes.modbus_io import Identity, Module, ModuleFaults, ModuleWires, Pace, TcpPlace, register_map
from fakes.world.beams.input_module import InputModule
from fakes.world.beams.truth import IoTruth
from fakes.world.scenario import FakeAddresses

SERIAL_LINE = "io.tty"
POLL_PERIOD_S = 0.005


class TwinInputs:
    """Serves ``inputs`` between :meth:`start` and :meth:`stop`, each answer as of ``now``."""

    def __init__(
        self,
        inputs: InputModule,
        addresses: FakeAddresses,
        bind: str,
        folder: Path,
        now: Callable[[], float],
    ) -> None:
        self._truth: IoTruth = inputs.truth
        module = Module(
            inputs,
            register_map(self._truth.module),
            Identity(self._truth.module, self._truth.serial),
            now,
        )
        line = folder / SERIAL_LINE if addresses.io_rtu else None
        pace = Pace(addresses.io_delay_s, addresses.io_jitter_s)
        self._wires = ModuleWires(module, (TcpPlace(bind, addresses.io_port),), line, pace)
        self._input_faults = InputFaults(inputs, time.monotonic)
        self.faults = ModuleFaults(self._wires, self._input_faults)

    async def start(self) -> None:
        """Listen; ``OSError`` when the address is taken."""
        await self._wires.start()

    async def stop(self) -> None:
        """Close everything."""
        self.faults.close()
        self._input_faults.close()
        await self._wires.stop()

    def addresses(self) -> dict[str, str]:
        """What listens where, by name."""
        host, port = self._wires.addresses[0]
        line = self._wires.line
        return {"inputs": f"tcp://{host}:{port}"} | (
            {"inputs serial": f"rtu://{line.path}?baudrate=115200"} if line else {}
        )

    def device(self) -> dict[str, Any]:
        """The table ``[device.beams]`` of a daemon's configuration."""
        return {
            "driver": "modbus-inputs",
            "url": self.addresses()["inputs"],
            "module": self._truth.module,
            "poll_period_s": POLL_PERIOD_S,
            "filter_s": self._truth.filter_s,
            "inputs": {
                name: {"address": channel, "invert": name in self._truth.inverted}
                for name, channel in self._truth.inputs.items()
            },
            **self._counters(),
        }

    def _counters(self) -> dict[str, Any]:
        """A generic module's counters have no place of their own, and others' may be off."""
        if self._truth.module == "generic":
            return {"counters": {"table": "input", "address": 0}} if self._truth.counters else {}
        return {} if self._truth.counters else {"use_counters": False}
