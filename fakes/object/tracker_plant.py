"""The tracker of the object face as a thing: the world's instrument, and the faults of its link."""

from collections.abc import Callable

from cell.clock import Clock
from fakes.faults.tracker import TrackerFaults
from fakes.faults.vocabulary import Fault
from fakes.object._plant import Plant
from fakes.world.tracker.tracker import Tracker


class TrackerPlant(Plant):
    """The instrument at the far end of the cable, with its own faults beside those of every link."""

    def __init__(self, tracker: Tracker, clock: Clock) -> None:
        super().__init__("tracker", clock, tracker.truth.serial)
        self.tracker = tracker
        self._tracker_faults = TrackerFaults(tracker, clock.now)
        self.faults |= {fault.value: self._named(fault) for fault in self._tracker_faults.offers()}

    def clear(self) -> None:
        """Clear the view, and end the faults of the link."""
        self.settle_past()
        self._tracker_faults.clear()
        super().clear()

    def _named(self, fault: Fault) -> Callable[..., None]:
        def begin(duration_s: float | None = None, **arguments: object) -> None:
            if duration_s is not None:
                arguments["for_s"] = duration_s
            self._tracker_faults.inject(fault, arguments)

        return begin

    def _reboot(self, serial: str | None = None, boot_s: float = 1.0) -> None:
        self.tracker.restart(self.clock.now())
        super()._reboot(serial, boot_s)
