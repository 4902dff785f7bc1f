"""The observed arm of the object face as a thing: the world's palletizer, and the faults of its link."""

from cell.clock import Clock
from fakes.faults.palletizer import ObservedFaults
from fakes.object._plant import FaultyPlant
from fakes.world.palletizer.observed import ObservedPalletizer


class ObservedPlant(FaultyPlant):
    """The arm's controller at the far end of the cable; the arm's own faults beside those of every link."""

    def __init__(self, arm: ObservedPalletizer, clock: Clock) -> None:
        super().__init__("palletizer", clock, arm.truth.serial, ObservedFaults(arm, clock.now))
        self.arm = arm
