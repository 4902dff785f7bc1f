"""The belt's encoder in a twin: the world's encoder on its bus, and what a daemon must know to read it."""

import time
from pathlib import Path
from typing import Any

from fakes.can import CanFaults, CanWires
from fakes.faults.belt import BeltFaults
from fakes.wire.listening import TcpPlace
from fakes.world.belt.encoder import BeltEncoder
from fakes.world.scenario import FakeAddresses

SERIAL_LINE = "can.tty"


class TwinEncoder:
    """Serves ``encoder`` between :meth:`start` and :meth:`stop`."""

    def __init__(self, encoder: BeltEncoder, addresses: FakeAddresses, bind: str, folder: Path) -> None:
        self._truth, self._interface = encoder.truth, addresses.can
        self._wires = CanWires(
            encoder,
            encoder.truth.node,
            int(encoder.truth.serial),
            time.monotonic,
            folder / SERIAL_LINE,
            TcpPlace(bind, addresses.can_port),
            encoder.truth.by_events,
        )
        self._shaft_faults = BeltFaults(encoder, time.monotonic)
        self.faults = CanFaults(self._wires, self._shaft_faults)

    async def start(self) -> None:
        """Listen; ``OSError`` when the address is taken."""
        await self._wires.start()

    async def stop(self) -> None:
        """Close everything."""
        self.faults.close()
        self._shaft_faults.close()
        await self._wires.stop()

    def addresses(self) -> dict[str, str]:
        """What listens where, by name."""
        return {f"encoder {name}": bus for name, bus in self._wires.buses.items()}

    def device(self) -> dict[str, Any]:
        """The table ``[device.belt]`` of a daemon's configuration."""
        return {
            "driver": "canopen-encoder",
            "bus": self._wires.buses[self._interface],
            "node": self._truth.node,
            "period_s": self._truth.period_s,
        }
