"""The tracker of the object face as a thing: the world's instrument, and the faults of its link."""

from cell.clock import Clock
from fakes.faults.tracker import TrackerFaults
from fakes.object._plant import FaultyPlant
from fakes.world.tracker.tracker import Tracker


class TrackerPlant(FaultyPlant):
    """The instrument at the far end of the cable, with its own faults beside those of every link."""

    def __init__(self, tracker: Tracker, clock: Clock) -> None:
        super().__init__("tracker", clock, tracker.truth.serial, TrackerFaults(tracker, clock.now))
        self.tracker = tracker

    def _reboot(self, serial: str | None = None, boot_s: float = 1.0) -> None:
        self.tracker.restart(self.clock.now())
        super()._reboot(serial, boot_s)
