"""What a source of stamps has to bring so that its delay can be measured."""

from typing import Any, ClassVar, Protocol

from cell.procedure import Run
from cell.run_values import RunValues
from procedures.latency.config import LatencyCalibrationConfig


class DelayedDevice(Protocol):
    """A device whose stamps are late against the arm's, and something that shows by how much.

    The job keeps what was taken, solves it, holds the answer against its limits and proposes
    ``time_offset_s`` of the device. A source brings the rest:

    - *name*: ``role`` is its role in ``[robot]``, the key of ``values.time_offset_s`` and, for the config,
      one more word of ``source``; it stands in ``LatencyCalibration.SOURCES``;
    - *record*: :meth:`take` has both streams on disk, each with its own stamps: those of the device as its
      driver gives them, without what a version in the ledger takes off;
    - *turn to a delay*: ``signal`` names a function of ``procedures.latency.solver.SIGNALS``. From the data
      set alone it makes a :class:`calibration.latency.delay.Delay`.

    Where the arm moves it goes out and back at several speeds (:mod:`procedures.latency.to_and_fro`): a delay
    ``tau`` shifts what the source sees by ``v tau`` along the way, forward one time and backward the other.
    """

    role: ClassVar[str]
    signal: ClassVar[str]

    def __init__(self, config: LatencyCalibrationConfig, run: Run) -> None: ...

    @staticmethod
    def uses() -> tuple[str, ...]:
        """Roles of ``[robot]`` that are needed."""
        ...

    @staticmethod
    def refuse(config: LatencyCalibrationConfig, values: RunValues) -> None:
        """Raise the coded error that forbids the job with these values, before a run begins."""
        ...

    @property
    def device(self) -> str:
        """Name of the device that the offset belongs to."""
        ...

    def data(self) -> dict[str, Any]:
        """What was taken, and what the signal needs beside it; into the data set."""
        ...

    def amount(self) -> str:
        """How much was taken, in words; empty when nothing was."""
        ...

    async def plan(self) -> dict[str, Any]:
        """Every move in order with the guard's findings; nothing moves."""
        ...

    async def check(self) -> None:
        """Raise when the source does not see what it must before anything moves."""
        ...

    async def take(self) -> None:
        """Everything between the checks and the solution; a request to finish ends it early."""
        ...
