"""The observed arm of the object face as a thing: the world's palletizer, and the faults of its link."""

from collections.abc import Callable

from cell.clock import Clock
from fakes.faults.palletizer import ObservedFaults
from fakes.faults.vocabulary import Fault
from fakes.object._plant import Plant
from fakes.world.palletizer.observed import ObservedPalletizer


class ObservedPlant(Plant):
    """The arm's controller at the far end of the cable; the arm's own faults beside those of every link."""

    def __init__(self, arm: ObservedPalletizer, clock: Clock) -> None:
        super().__init__("palletizer", clock, arm.truth.serial)
        self.arm = arm
        self._arm_faults = ObservedFaults(arm, clock.now)
        self.faults |= {fault.value: self._named(fault) for fault in self._arm_faults.offers()}

    def clear(self) -> None:
        """Free the registers, and end the faults of the link."""
        self.settle_past()
        self._arm_faults.clear()
        super().clear()

    def _named(self, fault: Fault) -> Callable[..., None]:
        def begin(duration_s: float | None = None, **arguments: object) -> None:
            if duration_s is not None:
                arguments["for_s"] = duration_s
            self._arm_faults.inject(fault, arguments)

        return begin
