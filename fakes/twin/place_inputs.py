"""The input of a twin that tells whether the place is clear where items are put down, on a Modbus module."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from fakes.modbus_io import Identity, Module, ModuleFaults, ModuleWires, Pace, TcpPlace, register_map
from fakes.world.belt.place import Place
from fakes.world.scenario import FakeAddresses

SERIAL, MODULE, CHANNEL = "99993300002", "generic", 0


class PlaceLevel:
    """``fakes.modbus_io.module.Inputs`` with one input and no counters."""

    def __init__(self, place: Place) -> None:
        self._place = place

    def levels(self, t: float) -> tuple[bool, ...]:
        return (self._place.is_clear(t),)

    def counts(self, t: float) -> tuple[int, ...]:
        return ()

    def reboot(self, t: float) -> None:
        """The sensor does not notice."""


class TwinPlaceInputs:
    """Serves ``place`` between :meth:`start` and :meth:`stop`, each answer as of ``now``."""

    def __init__(
        self, place: Place, addresses: FakeAddresses, bind: str, folder: Path, now: Callable[[], float]
    ) -> None:
        self._input = place.truth.input
        module = Module(PlaceLevel(place), register_map(MODULE), Identity(MODULE, SERIAL), now)
        pace = Pace(addresses.io_delay_s, addresses.io_jitter_s)
        self._wires = ModuleWires(module, (TcpPlace(bind, addresses.place_port),), pace=pace)
        self.faults = ModuleFaults(self._wires)

    async def start(self) -> None:
        """Listen; ``OSError`` when the address is taken."""
        await self._wires.start()

    async def stop(self) -> None:
        """Close everything."""
        self.faults.close()
        await self._wires.stop()

    def addresses(self) -> dict[str, str]:
        """What listens where, by name."""
        host, port = self._wires.addresses[0]
        return {"place inputs": f"tcp://{host}:{port}"}

    def device(self) -> dict[str, Any]:
        """The table ``[device.place_inputs]`` of a daemon's configuration."""
        return {
            "driver": "modbus-inputs",
            "url": self.addresses()["place inputs"],
            "module": MODULE,
            "inputs": {self._input: {"address": CHANNEL}},
        }
