"""Picking decides when it did: the run's own record tells the instants.

What a stream of set-points sends depends on the instant at which it looks at arm, encoder and pictures. It
sleeps from one decision to the next, and wakes a little late, as a machine does. Here it wakes as late as it
did, so that each set-point is for the instant that it was for.
"""

import asyncio
import bisect
from collections.abc import AsyncIterator, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from cell.devices import Encoder, TrajectoryPiece
from cell.poses import Array
from cell.store.runs import list_runs
from drivers.ur.pieces import Following
from fakes.object import VirtualClock
from procedures.belt.motion.tool_path import STEP_S
from procedures.belt.record import COUNT, COUNTS_FILE, STEP, STEPS_FILE, PickRecord, read_rows

LATEST_S = 0.1  # that a stream which goes on decided after its time
SAME_S = 1e-6  # instants that are no further apart are the same
WAIT_S = 0.1  # at most, for the count before the first of a record


def steps_of(state: Path) -> Array:
    """(n, 4) of the runs below ``state``: the instant of each set-point, s, and the tool's point then, m."""
    rows = [
        read_rows(run.path / STEPS_FILE, STEP)
        for run in list_runs(state / "runs")
        if (run.path / STEPS_FILE).exists()
    ]
    return np.concatenate([np.column_stack([r["t"], r["p"][:, :3]]) for r in rows] or [np.empty((0, 4))])


def first_counts(state: Path) -> list[float]:
    """The time of the first count in the record of each run below ``state``, s."""
    found = []
    for run in list_runs(state / "runs"):
        if (run.path / COUNTS_FILE).exists() and len(rows := read_rows(run.path / COUNTS_FILE, COUNT)):
            found.append(float(rows["t"][0]))
    return found


class RecordedClock(VirtualClock):
    """Virtual time in which picking does its part when it did.

    ``instants`` are those of the recorded set-points, in order; ``first_counts`` tell when records began: a
    disk took its time for that.
    """

    def __init__(self, offset_s: float, instants: Sequence[float], first_counts: Sequence[float]) -> None:
        super().__init__(offset_s)
        self._instants, self._first_counts = instants, first_counts
        self._deciding: asyncio.Task[Any] | None = None
        self._latest: float | None = None  # instant of the stream's newest set-point

    async def sleep(self, seconds: float) -> None:
        if asyncio.current_task() is self._deciding and self._latest is not None:
            planned = self._latest + STEP_S
            recorded = _next(self._instants, planned - SAME_S)
            if recorded is not None and recorded - planned < LATEST_S:
                seconds += max(recorded - planned, 0.0)
        await super().sleep(seconds)

    @contextmanager
    def pacing(self) -> Iterator[None]:
        """Streams that are sent, and records that begin, meanwhile."""
        clock = self
        send, goes, enter = Following.send, PickRecord.goes, PickRecord.__aenter__

        async def send_paced(self: Following, pieces: Any, joints: Any) -> Any:
            return await send(self, clock._paced(pieces), joints)

        def note_instant(self: PickRecord, t: float, *more: Any) -> None:
            clock._latest = t
            goes(self, t, *more)

        async def enter_in_time(self: PickRecord) -> PickRecord:
            if (first := _next(clock._first_counts, clock.now() - WAIT_S)) is not None:
                await clock._count_before(first, self._encoder)
            return await enter(self)

        with (
            patch.object(Following, "send", send_paced),
            patch.object(PickRecord, "goes", note_instant),
            patch.object(PickRecord, "__aenter__", enter_in_time),
        ):
            yield

    async def _count_before(self, first: float, encoder: Encoder) -> None:
        """Return when the count before that of ``first`` has come."""
        come = asyncio.Event()
        before = first - 1.5 * encoder.period_s
        undo = encoder.counts.subscribe(lambda sample: come.set() if sample.t > before else None)
        try:
            with suppress(TimeoutError):
                async with asyncio.timeout(max(first - self.now(), 0.0) + WAIT_S):
                    await come.wait()
        finally:
            undo()

    async def _paced(self, pieces: AsyncIterator[TrajectoryPiece]) -> AsyncIterator[TrajectoryPiece]:
        """The same pieces; each is made by a task of its own, which the clock knows."""
        iterator, self._latest = aiter(pieces), None
        while True:
            self._deciding = asyncio.current_task()
            try:
                piece = await anext(iterator, None)
            finally:
                self._deciding = None
            if piece is None:
                return
            yield piece


def _next(times: Sequence[float], t: float) -> float | None:
    """The first of ``times`` from ``t`` on."""
    place = bisect.bisect_left(times, t)
    return times[place] if place < len(times) else None
