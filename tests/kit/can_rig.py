"""An encoder on CAN with a shaft that a test turns, for tests on real serial lines and sockets."""

import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from cell.clock import MonotonicClock
from drivers.can_encoder import CanopenEncoder, CanopenEncoderConfig
from fakes.can import CanFaults, CanWires
from fakes.wire.listening import TcpPlace

NODE, SERIAL = 5, 999966001


class TestShaft:
    """Turns at a constant speed from position 0 at ``begin``; ``marks`` is what the test asked of it."""

    __test__ = False

    def __init__(self, speed: float = 1000.0, modulus: int = 65536) -> None:
        self.begin, self.rate, self.modulus = time.monotonic(), speed, modulus
        self.marks: list[tuple[str, int]] = []

    def told(self, t: float) -> float:
        return t

    def raw(self, t: float) -> int:
        return int((t - self.begin) * self.rate + 0.5) % self.modulus

    def speed(self, t: float) -> float:
        return self.rate

    def preset(self, t: float, position: int) -> None:
        self.begin = t - position / self.rate

    def restart(self, t: float) -> None:
        self.marks.append(("restart", 0))


class CanRig:
    """A node, its wires and a driver's configuration for it."""

    def __init__(self, wires: CanWires, shaft: TestShaft) -> None:
        self.wires, self.shaft, self.faults = wires, shaft, CanFaults(wires)
        self.node, self.bus = wires.node, wires.bus

    def config(self, interface: str, **more: object) -> CanopenEncoderConfig:
        """A driver's configuration."""
        # Wide limits for all but the tests of them: device and driver share a process that may be paused.
        wide = {"connect_timeout_s": 2.0, "lost_after_s": 2.0}
        keys = {"bus": self.wires.buses[interface], "node": NODE, **wide, **more}
        return CanopenEncoderConfig.model_validate(keys)

    def driver(self, interface: str, **more: object) -> CanopenEncoder:
        """A driver for the node, not yet open."""
        return CanopenEncoder("belt", self.config(interface, **more), MonotonicClock())


@asynccontextmanager
async def can_rig(host: str, shaft: TestShaft | None = None) -> AsyncIterator[CanRig]:
    """A node on a serial adapter and on a gateway at ``host``."""
    shaft = shaft or TestShaft()
    with TemporaryDirectory(prefix="can-") as folder:
        line, place = Path(folder) / "can.tty", TcpPlace(host, 0)
        wires = CanWires(shaft, NODE, SERIAL, time.monotonic, line, place)
        await wires.start()
        rig = CanRig(wires, shaft)
        try:
            yield rig
        finally:
            rig.faults.close()
            await wires.stop()
