"""What ends a run from outside its job: a device that drops and does not come back, or a fault of the arm."""

import asyncio
from collections.abc import Container, Sequence

from cell.devices import Arm
from cell.errors import CellError, error, present
from cell.interruptions import SILENCES
from cell.motion import MotionBroker
from cell.procedure import Run
from daemon.supervisor import Supervisor


class Losses:
    """Watches the ``devices`` of one run, and its ``arm``, which is None in a job without one."""

    def __init__(
        self, supervisor: Supervisor, broker: MotionBroker, devices: Sequence[str], arm: Arm | None
    ) -> None:
        self._supervisor, self._broker = supervisor, broker
        self._devices, self._arm = tuple(devices), arm

    async def first(self, run: Run) -> CellError:
        """Block until the job must end, and return why.

        A device that was silent for a moment interrupts the step that is under way, and no more.
        """
        steps = run.steps_taken
        while True:
            fault = await self._next()
            if not steps.bridges(fault):
                return fault
            steps.interrupt(fault)
            if (other := await self._until_back(fault, steps.limits.until_lost_s)) is not None:
                return other
            run.note("device", event="lost and back", **fault.as_dict())  # also where no step was under way

    async def _next(self) -> CellError:
        """Block until a device drops or the arm shows a fault."""
        lost = asyncio.create_task(self._supervisor.first_loss(self._devices))
        done = await _first_of([lost, *self._faults()], None)
        return _as_coded(present(done, "fault, though nothing else ends the wait").result())

    async def _until_back(self, fault: CellError, timeout: float) -> CellError | None:
        """None when all devices are back in time, else why the run ends.

        Who waits for one device watches the arm all the same: a safety stop that passes again is one.
        """
        back = asyncio.create_task(self._supervisor.back(self._devices))
        done = await _first_of([back, *self._faults(ignoring=SILENCES)], timeout)
        if done is None:
            return fault
        if done is not back:
            return _as_coded(done.result())
        try:
            done.result()
        except Exception as other:
            return _as_coded(other)
        return None

    def _faults(self, ignoring: Container[str] = ()) -> list[asyncio.Task[Exception]]:
        if self._arm is None:
            return []
        return [asyncio.create_task(self._broker.first_fault(self._arm, ignoring))]


async def _first_of(
    tasks: Sequence[asyncio.Task[Exception] | asyncio.Task[None]], timeout: float | None
) -> asyncio.Task[Exception] | asyncio.Task[None] | None:
    """The last of those that have ended when the first one has, None at the time-out; all are over then."""
    try:
        done, _ = await asyncio.wait(tasks, timeout=timeout, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.wait(tasks)
    return next((task for task in reversed(tasks) if task in done), None)


def _as_coded(loss: Exception | None) -> CellError:
    return loss if isinstance(loss, CellError) else error("DEVICE_LOST", f"{type(loss).__name__}: {loss}")
