"""What a source of stamps has to bring so that its delay can be measured."""

from typing import Any, ClassVar, Protocol

from cell.motion import MotionLease
from cell.procedure import Run
from cell.run_values import RunValues
from procedures.latency.config import LatencyCalibrationConfig


class DelayedDevice(Protocol):
    """A device whose stamps are late against the arm's, and a motion of the arm that shows by how much.

    The job moves the arm out and back at each speed, so that a delay ``tau`` shifts what the source sees by
    ``v tau`` along the way, forward one time and backward the other. It keeps the passes, solves them, holds
    the answer against its limits and proposes ``time_offset_s`` of the device. A source brings the rest:

    - *name*: ``role`` is its role in ``[robot]``, the key of ``values.time_offset_s`` and, for the config,
      one more word of ``source``; it stands in ``LatencyCalibration.SOURCES``;
    - *excite* and *record*: :meth:`approach`, :meth:`excite` and :meth:`leave` move the arm, and ``passes``
      has what both streams showed on each way that can be used, with their own stamps;
    - *turn to a signal*: ``signal`` names a function of ``procedures.latency.solver.SIGNALS``. From the data
      set alone it makes :class:`calibration.latency.SeenCrossing` s: where the arm was when the source saw it
      pass a fixed place, one for each place and way.

    For beams the places are the edges of the tool. A source that reads a position (tracker, camera, the
    encoder of a belt that the arm drives or follows) has as many places as one likes: fixed levels of its
    own reading, and ``dt`` of a crossing is half the time between the two readings around the level.
    """

    role: ClassVar[str]
    signal: ClassVar[str]
    passes: list[dict[str, Any]]

    def __init__(self, config: LatencyCalibrationConfig, run: Run) -> None: ...

    @staticmethod
    def refuse(config: LatencyCalibrationConfig, values: RunValues) -> None:
        """Raise the coded error that forbids the job with these values, before a run begins."""
        ...

    @property
    def device(self) -> str:
        """Name of the device that the offset belongs to."""
        ...

    def about(self) -> dict[str, Any]:
        """What the signal needs beside the passes; into the data set."""
        ...

    async def plan(self) -> dict[str, Any]:
        """Every move in order with the guard's findings; nothing moves."""
        ...

    async def check(self) -> None:
        """Raise when the source does not see what it must before anything moves."""
        ...

    async def approach(self, lease: MotionLease) -> None:
        """To where the first way out begins."""
        ...

    async def excite(self, lease: MotionLease, speed_m_s: float, number: int) -> None:
        """Out and back at ``speed_m_s``, recorded and on disk; again when it cannot be used.

        ``number`` counts the passes at this speed: readings of several should fall differently on the way.
        Enters the states ``sweep`` and ``return``; the first is a checkpoint.
        """
        ...

    async def leave(self, lease: MotionLease) -> None:
        """To where the arm may be left."""
        ...
