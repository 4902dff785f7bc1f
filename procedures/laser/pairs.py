"""A way across a beam and the way back: swept, judged, on disk before the next, and again while it fails."""

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from math import gcd

from scipy.spatial.transform import RigidTransform

from cell.devices import Speed
from cell.procedure import Run
from procedures.laser.config import Search
from procedures.laser.faults import PassFault, one_sided
from procedures.laser.path import BeamStation
from procedures.laser.record import PassRecord
from procedures.laser.states import ScanState as S
from procedures.laser.sweep import Beam, BeamPass, Sweeper

Pair = tuple[BeamPass, BeamPass]
BackAt = Callable[[BeamPass], Awaitable[float]]
Judge = Callable[[BeamPass, BeamPass], PassFault | None]
SEARCH = "search"
LOCATE = "locate"
HEIGHT = "bisect"


@dataclass(frozen=True)
class Pairs:
    """Takes pairs of ways with one lease; ``record`` keeps them."""

    run: Run
    search: Search
    record: PassRecord
    sweeper: Sweeper

    async def take(
        self,
        station: BeamStation,
        beam: Beam,
        depth: float,
        span: tuple[float, float],
        speed: Speed,
        judge: Judge,
        phase: str,
        after_poll_s: tuple[float, float] = (0.0, 0.0),
        back_at: BackAt | None = None,
    ) -> Pair:
        """From where it stands to the end of ``span`` and back to its begin, again while ``judge`` faults.

        ``span`` (m) is counted along the way out at ``depth``; ``after_poll_s`` is how long after a poll each
        way begins. ``back_at`` names the depth of the way back once it has seen the way out. The last fault's
        error after as many attempts as the search allows.
        """
        near, far = station.at(span[0], depth), station.at(span[1], depth)
        begun = False

        async def turn(out: BeamPass) -> RigidTransform:
            """To where the way back begins, and where it ends."""
            if back_at is None:
                return near
            there = await back_at(out)
            await self.sweeper.lease.move_linear(station.at(span[1], there))
            return station.at(span[0], there)

        async def take() -> tuple[Pair, bool]:
            nonlocal begun
            if begun:  # an interruption left the tool somewhere on the way
                await self.sweeper.lease.move_linear(near)
            begun = True
            return await self._take(station, beam, near, far, turn, speed, judge, phase, after_poll_s)

        pair, usable = await self.run.take_step(f"{phase} pass of {station.name}", take)
        if usable:  # a pair that an interruption touched is taken again, and is not to be used
            await asyncio.to_thread(self.record.add, pair, phase, station.place, None)
        return pair

    async def _take(
        self,
        station: BeamStation,
        beam: Beam,
        near: RigidTransform,
        far: RigidTransform,
        turn: Callable[[BeamPass], Awaitable[RigidTransform]],
        speed: Speed,
        judge: Judge,
        phase: str,
        after_poll_s: tuple[float, float],
    ) -> tuple[Pair, bool]:
        """The pair, and whether it is to be used; one that is not is on disk when this returns."""
        run = self.run
        for attempt in range(1, self.search.retries + 2):
            await run.enter(S.SWEEP, f"{phase}, attempt {attempt}" if attempt > 1 else phase)
            if attempt > 1 and phase == HEIGHT:
                await self.sweeper.lease.move_linear(near)
            out = await self.sweeper.cross(beam, 1, far, speed, after_poll_s[0])
            await run.enter(S.RETURN)
            end = await turn(out)
            back = await self.sweeper.cross(beam, -1, end, speed, after_poll_s[1])
            fault = judge(out, back)
            why_not = fault or one_sided(out, back)
            # What shows on one way alone tells the height all the same.
            if fault is None and phase in (SEARCH, HEIGHT):
                why_not = None
            text = why_not.text if why_not else "only finds where to measure" if phase == LOCATE else None
            if text is not None:
                await asyncio.to_thread(self.record.add, (out, back), phase, station.place, text)
            if why_not is not None:
                run.note("decision", event="pass not used", phase=phase, attempt=attempt, why=why_not.text)
            if fault is None:
                return (out, back), text is None
            last = fault.error(attempt)
        raise last


def beam_of(search: Search, name: str, inputs: tuple[str, ...]) -> Beam:
    """How beam ``name`` is read from a device with these ``inputs``, and crossed."""
    section = search.beam(name)
    return Beam(name, inputs.index(section.input), section.across_unit)


def even_shares(count: int, first: float = 0.0) -> list[tuple[float, float]]:
    """For ``count`` pairs, by which share of the polls' period the two ways begin after a poll.

    Polls that fall differently in each way narrow the intervals of the edges together. The shares are spread
    evenly from ``first`` on, those of the ways back between those of the ways out. From four pairs on those
    of ways that follow each other are far apart: what the arm is off by at the standstill that they have in
    common must not count twice where the intervals are cut most.
    """
    ways = 2 * count
    step = max((k for k in range(1, ways) if gcd(k, ways) == 1), key=lambda k: min(k, ways - k))
    shares = [(first + k * step % ways / ways) % 1.0 for k in range(ways)]
    return list(zip(shares[::2], shares[1::2], strict=True))
