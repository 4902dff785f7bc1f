"""The palletizer of a twin: its controller's registers on the wire, or a file that grows at each rest."""

import asyncio
import time
from pathlib import Path
from typing import Any

from fakes.faults.palletizer import ObservedFaults
from fakes.faults.vocabulary import Faulty
from fakes.modbus_io import ModuleFaults, ModuleWires, Pace, TcpPlace
from fakes.modbus_io.palletizer import ObservedRegisters
from fakes.world.palletizer.observed import ObservedPalletizer
from fakes.world.scenario import FakeAddresses

JOINTS_FILE = "joints.csv"
_LOOK_S = 0.05


class TwinObserved:
    """Serves ``arm`` between :meth:`start` and :meth:`stop`."""

    def __init__(self, arm: ObservedPalletizer, addresses: FakeAddresses, bind: str, folder: Path) -> None:
        self._arm_faults = ObservedFaults(arm, time.monotonic)
        self._registers = ObservedRegisters(arm, time.monotonic)
        self._wires: ModuleWires | None = None
        self._file: RestFile | None = None
        self.faults: Faulty = self._arm_faults
        if addresses.observed_by == "file":
            self._file = RestFile(arm, folder / JOINTS_FILE)
            self._url = f"file://{self._file.path}"
        else:
            pace = Pace(addresses.io_delay_s, addresses.io_jitter_s)
            self._url = f"tcp://{bind}:{addresses.observed_port}"
            self._wires = ModuleWires(self._registers, (TcpPlace(bind, addresses.observed_port),), pace=pace)
            self.faults = self._wire_faults = ModuleFaults(self._wires, self._arm_faults)

    async def start(self) -> None:
        """Listen, or begin the file; ``OSError`` when that cannot be."""
        if self._wires is not None:
            await self._wires.start()
        if self._file is not None:
            self._file.start()

    async def stop(self) -> None:
        """Close everything."""
        self._arm_faults.close()
        if self._wires is not None:
            self._wire_faults.close()
            await self._wires.stop()
        if self._file is not None:
            await self._file.stop()

    def addresses(self) -> dict[str, str]:
        """What listens where, by name."""
        return {"palletizer": self._url}

    def device(self) -> dict[str, Any]:
        """The section of a daemon's configuration."""
        section: dict[str, Any] = {"driver": "observed-arm", "url": self.addresses()["palletizer"]}
        if self._file is not None:
            arm = self._file.arm
            return {**section, "model": arm.truth.model, "joints": [{"unit": "rad"}] * arm.axes}
        return {**section, **self._registers.device(), "allow_requests": True}


class RestFile:
    """Adds a row to a CSV each time the arm has come to rest, as a robot's program would."""

    def __init__(self, arm: ObservedPalletizer, path: Path) -> None:
        self.arm, self.path = arm, path
        self._task: asyncio.Task[None] | None = None

    def start(self) -> None:
        """Write the header and begin to watch."""
        names = ",".join(f"q{i}" for i in range(1, self.arm.axes + 1))
        self.path.write_text(f"# serial: {self.arm.truth.serial}\nt,{names},pose\n", "utf-8")
        self._task = asyncio.get_running_loop().create_task(self._watch())

    async def stop(self) -> None:
        """Write no more."""
        if self._task is not None:
            self._task.cancel()
            await asyncio.wait([self._task])

    async def _watch(self) -> None:
        moved = False
        while True:
            await asyncio.sleep(_LOOK_S)
            t = time.monotonic()
            if self.arm.moving(t):
                moved = True
            elif moved and self.arm.track.end_time <= t:
                moved = False
                self._write(t)

    def _write(self, t: float) -> None:
        q = ",".join(repr(float(x)) for x in self.arm.joints(t))
        with self.path.open("a", encoding="utf-8") as file:
            file.write(f"{t:.3f},{q},{self.arm.reached(t) or ''}\n")
