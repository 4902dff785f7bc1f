"""What an arm has shown since a moment: its first fault, its silences, and where it stands."""

import asyncio

import numpy as np

from cell.devices import Arm, ArmState
from cell.errors import error
from cell.motion import MAX_STATE_AGE_S
from cell.samples import Sample
from cell.where_left import STAYED_RAD


class ArmSince:
    """Watches ``arm`` from now on until :meth:`end`; a fault that has passed again counts, too."""

    def __init__(self, arm: Arm) -> None:
        self._arm = arm
        self.began = arm.state.clock.now()
        state = arm.state.latest(MAX_STATE_AGE_S)
        self._q, self._t, self._epoch = state.value.q, state.t, arm.state.epoch
        self._fault: Exception | None = None
        self._faulty = asyncio.Event()
        self._unsubscribe = arm.state.subscribe(self._look)
        self._look()

    def end(self) -> None:
        """Watch no more."""
        self._unsubscribe()

    async def first_fault(self) -> Exception:
        """Block until a package shows a fault, or return the one that was there."""
        await self._faulty.wait()
        return self._fault or error("INTERNAL", "a fault without an error")

    def require_untouched(self) -> None:
        """Refused unless the arm had no fault, was seen all the time since, and stands where it stood."""
        arm, name = self._arm, self._arm.name
        self._look()
        if self._fault is not None:
            raise self._fault
        state = arm.state.latest(MAX_STATE_AGE_S).value
        if arm.state.epoch != self._epoch:
            raise error("DEVICE_LOST", f"{name} was connected anew since the run's end")
        if (gap := arm.state.last_gap) is not None and gap[1] > self._t:
            raise error("STALE_DATA", f"{name} gave no state for {gap[1] - gap[0]:.3f} s since the run's end")
        if (turned := float(np.max(np.abs(state.q - self._q)))) > STAYED_RAD:
            raise error("ARM_MOVED", f"{name}: a joint turned by {turned:.4f} rad since the run's end")

    def _look(self, _: Sample[ArmState] | None = None) -> None:
        if self._fault is None and (fault := self._arm.fault()) is not None:
            self._fault = fault
            self._faulty.set()
