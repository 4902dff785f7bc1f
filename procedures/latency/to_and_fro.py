"""The arm goes out and back at each speed, and comes to rest where it may be left."""

from contextlib import suppress
from typing import Protocol

from cell.motion import MotionLease
from cell.procedure import FinishRequested, Run
from procedures.latency.config import LatencyCalibrationConfig
from procedures.latency.states import S


class MovingSource(Protocol):
    """What a source does with the arm; the names are those of the states."""

    @property
    def device(self) -> str: ...

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


async def to_and_fro(source: MovingSource, config: LatencyCalibrationConfig, run: Run) -> None:
    """With one lease, at each speed and as often as configured; a request to finish ends it early."""
    async with run.motion() as lease:
        with suppress(FinishRequested):
            await run.enter(S.APPROACH, source.device)
            await source.approach(lease)
            run.progress(0, len(config.speeds) * config.passes)
            for speed in config.speeds:
                for number in range(config.passes):
                    await source.excite(lease, speed, number)
                    run.progress(run.step + 1, run.steps)
        if run.state != S.APPROACH:  # a finish there finds the arm wherever it was
            await run.enter(S.LIFT)
            await source.leave(lease)
