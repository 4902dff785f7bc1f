"""The encoder of the object face as a thing: the world's encoder, and what can go wrong with its bus."""

from math import inf

from cell.clock import Clock
from cell.errors import error
from cell.samples import Quality
from fakes.faults.belt import BeltFaults
from fakes.object._plant import FaultyPlant
from fakes.world.belt.encoder import BeltEncoder


class EncoderPlant(FaultyPlant):
    """The node at the far end of the bus, with the faults of belt and shaft beside those of every link."""

    def __init__(self, encoder: BeltEncoder, clock: Clock) -> None:
        super().__init__("belt", clock, encoder.truth.serial, BeltFaults(encoder, clock.now))
        self.encoder = encoder
        self.faults |= {"unplug": self._unplug, "bus-off": self._bus_off, "node-stop": self._node_stop}
        self.faults["alarm"] = self._alarm
        self.emergency = ""

    def clear(self) -> None:
        """Free the shaft, let the belt run as it should, and end the faults of the bus."""
        self.settle_past()
        self._report("", Quality.GOOD)
        super().clear()

    def _reboot(self, serial: str | None = None, boot_s: float = 0.05) -> None:
        """The node starts again: a new epoch, or a lost link when it takes too long or is another node."""
        if serial not in (None, self.serial):
            super()._reboot(serial, boot_s)
            self.encoder.restart(self.clock.now())
            return
        self._silence()
        self.later(boot_s, self._booted)

    def _booted(self) -> None:
        self.silent = False
        self.encoder.restart(self.clock.now())
        for link in self.links:
            link.stream.start()
        self.announce()

    def _unplug(self, duration_s: float = inf) -> None:
        """The encoder says nothing and answers nothing."""
        self._refused_until = self.clock.now() + duration_s
        self._silence(None if duration_s == inf else duration_s)

    def _bus_off(self, duration_s: float = inf) -> None:
        self._refused_until = self.clock.now() + duration_s
        self.cut(error("CAN_BUS_OFF", self.name))

    def _alarm(self, code: int = 0x5000) -> None:
        """The encoder reports an emergency, until the faults are cleared, and counts on."""
        self._report(f"emergency {code:04X}h", Quality.DEGRADED)

    def _report(self, emergency: str, quality: Quality) -> None:
        self.emergency = emergency
        for link in self.links:
            link.stream.quality = quality

    def _node_stop(self) -> None:
        self.cut(error("ENCODER_NOT_OPERATIONAL", f"{self.name}: the node is stopped, and not by us"))
