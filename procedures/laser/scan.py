"""One scan of both beams: search down, find the height, measure slowly, at one or two places and heights.

The search goes out and back across the beam, a step down when nothing triggered; a trigger on one way
alone does not end it, and tells the height as all others do. The arm rests between the ways; what they
showed is on disk before the next.
"""

from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from cell.devices import DigitalInputs, Speed
from cell.errors import error, present
from cell.motion import MotionLease
from cell.procedure import FinishRequested, Run
from procedures.laser.config import BEAMS, Search
from procedures.laser.faults import crossing_fault, fault_of, gap_of, one_sided, stuck_dark
from procedures.laser.pairs import (
    HEIGHT,
    LOCATE,
    SEARCH,
    BackAt,
    Judge,
    Pair,
    Pairs,
    beam_of,
    even_shares,
)
from procedures.laser.path import BeamStation, Course, deepest, heights_at, highest, way_out
from procedures.laser.record import PassRecord
from procedures.laser.scan_progress import ScanProgress
from procedures.laser.sought_height import SoughtHeight, period_of
from procedures.laser.states import ScanState as S
from procedures.laser.sweep import POLL_TIMEOUT_S, BeamPass, Sweeper

SAME_M = 1e-6
GOLDEN = 0.6180339887498949  # multiples of it, modulo 1, are spread evenly however many they are


@dataclass(frozen=True)
class BeamContact:
    """The tool's end first meets the beam at ``depth`` (m), which is known to ``sigma``."""

    depth: float
    sigma: float


class _Turn:
    """The way back of a search has a height of its own, where the way out left most to learn."""

    def __init__(self, seek: SoughtHeight, out: float) -> None:
        self.seek, self.out, self.back = seek, out, out

    async def depth(self, way: BeamPass) -> float:
        """Of the way back (m), after this way out."""
        self.back = -(await self.seek.look((self.out, way))).next.height
        return self.back


class Scan:
    """Takes the passes of one course; ``complete`` says whether all that were planned are there."""

    def __init__(
        self,
        run: Run,
        search: Search,
        course: Course,
        record: PassRecord,
        speed: Speed,
        offset_s: float,
        retract_pose: str | None,
        sigma_m: float,
        scans: int,
        max_U_m: float,
    ) -> None:
        self.run, self.search, self.course, self.record = run, search, course, record
        self.inputs: DigitalInputs = run.inputs("beams")
        self.complete = False
        self._speed, self._offset_s, self._retract_pose = speed, offset_s, retract_pose
        self._sigma_m = sigma_m  # of one axis of the arm, by its data sheet
        self._beams = {name: beam_of(search, name, self.inputs.names) for name in BEAMS}
        self._max_U_m = max_U_m  # 95 % of the point, as the job wants it
        self._scans = scans  # that the run makes, this one included, when all goes well
        self._lease: MotionLease
        self._pairs: Pairs
        self._progress: ScanProgress
        self._station: BeamStation
        self._s, self._depth = 0.0, 0.0
        self._tried: list[
            tuple[float, BeamPass]
        ] = []  # by their depths, m; at this station, near the tool's end
        self._missing: dict[str, str] = {}
        self._groups = 0

    async def check_clear(self) -> None:
        """``LASER_BEAM_DARK`` when a beam is broken, with no tool near it."""
        if dark := await self._dark():
            raise error("LASER_BEAM_DARK", f"beam {dark[0]} is broken before anything moved")

    async def take(self, lease: MotionLease) -> None:
        """All passes; after a finish those that were taken by then. The tool ends clear of the beams."""
        run, arm, search = self.run, self.run.arm(), self.search
        self._lease = lease
        sweeper = Sweeper(arm, self.inputs, lease, run.clock, self._offset_s)
        self._pairs = Pairs(run, search, self.record, sweeper)
        self._first = True
        self._progress = ScanProgress(run, search, self.course, self._scans)
        with suppress(FinishRequested):
            for station in self.course.stations:
                if station.beam not in self._missing:
                    await self._take_station(station)
            self.complete = True
            self._progress.end()
        if run.state == S.SWEEP:
            await self._lift("finished early")
        if self.complete:
            self._raise_missing()
        await run.enter(S.RETRACT)
        if self._retract_pose is not None:
            await lease.move_joints(np.array(run.values.poses[self._retract_pose]))

    async def _take_station(self, station: BeamStation) -> None:
        self._progress.find(station)
        await self._approach(station)
        hit = await self._find()
        if hit is None:
            self._missing[station.beam] = self._searched()
        elif not self._missing:
            first, *deeper = heights_at(self.search, station)
            located = await self._locate(hit + first)
            met = await self._find_height(hit, located)
            facts = {"depth_m": round(met.depth, 6), "sigma_m": round(met.sigma, 7)}
            self.run.note("decision", event="hit", beam=station.beam, place=station.place, **facts)
            self._progress.measure(station)
            await self._measure(met.depth + first, located)
            for below in deeper:
                await self._measure(met.depth + below, await self._locate(met.depth + below))
        await self._lift(f"{station.name} is done")

    # -- the steps

    async def _approach(self, station: BeamStation) -> None:
        await self.run.enter(S.APPROACH, station.name)
        if self._first:
            self._first = False
            await leave_fixture(self.run, self._lease, self.course)
        if station.place == 0:
            await self._lease.move_joints(station.q)
        self._station, self._s, self._depth = station, 0.0, 0.0
        self._tried = []
        if not station.taught:
            await self._lease.move_linear(station.start)
        await self.run.clock.sleep(self.search.settle_s)
        if dark := await self._dark():
            raise error(
                "LASER_TOOL_TOO_LONG", f"beam {dark[0]} is broken at the auxiliary point of {station.name}"
            )

    async def _find(self) -> float | None:
        """Down by steps until out and back both trigger, and not a step above: the depth (m) where they do.
        None when they did not down to the limit."""
        step, lowest = self.search.descend_step_m, deepest(self.search, self.course, self._station)
        clear = False
        found: float | None = None
        lost = 0
        while True:
            out, back = await self._search_pair(
                SEARCH, 0.0, self._station.distance_m, self.search.search_speed_m_s
            )
            self._tried += [(self._depth, out), (self._depth, back)]
            if out.triggered and back.triggered:
                found = self._depth
                if clear:
                    return found
                await self._up_a_step(step)
                continue
            if found is not None:
                return found
            if (fault := one_sided(out, back)) is not None:
                lost += 1
                if lost > self.search.retries:
                    raise fault.error(lost)
            else:
                clear = True
            if self._depth + step > lowest + SAME_M:
                return None
            await self.run.enter(S.DESCEND, f"to {1e3 * (self._depth + step):.1f} mm")
            await self._move(0.0, self._depth + step)

    async def _up_a_step(self, step: float) -> None:
        """The beam was met at once: look for the height at which it is not."""
        up = step - self._depth
        if up > highest(self.search) + SAME_M:
            raise error(
                "LASER_TOOL_TOO_LONG",
                f"{self._station.name} is met {-1e3 * self._depth:.1f} mm above the auxiliary point already",
            )
        await self.run.enter(S.LIFT, "met at once, so the tool is longer than configured")
        await self._move(0.0, -up)

    async def _find_height(self, hit: float, located: Pair) -> BeamContact:
        """Cross near the tool's end where most is to be learned of its height, until it is known."""
        search, run = self.search, self.run
        seek = SoughtHeight(
            run.worker, search, self._sigma_m, self._max_U_m, hit, self._tried, located, self._station
        )
        now = await seek.look()
        for _ in range(search.most_height_pairs):
            if seek.known(now):
                break
            then = now.next
            begin, end = self._window(seek.span(then), then.speed)
            await run.enter(S.BISECT, f"known to {1e3 * now.sigma:.3f} mm")
            await self._move(begin, -then.height)
            turn = _Turn(seek, -then.height)
            out, back = await self._search_pair(HEIGHT, begin, end, then.speed, turn.depth)
            self._depth = turn.back
            seek.add(turn.out, out)
            seek.add(turn.back, back)
            now = await seek.look()
        return BeamContact(-now.mean, now.sigma)

    async def _locate(self, depth: float) -> Pair:
        """Cross once to see where the beam is at this depth."""
        await self.run.enter(S.MEASURE, f"{self._station.name}, {1e3 * depth:.2f} mm down")
        await self._move(0.0, self._depth)
        await self._move(0.0, depth)
        crossed = partial(crossing_fault, search=self.search)
        return await self._pair(LOCATE, 0.0, self._station.distance_m, self.search.search_speed_m_s, crossed)

    async def _measure(self, depth: float, seen: Pair) -> None:
        """Cross slowly as often as asked, where ``seen`` has shown the beam to be."""
        search = self.search
        await self.run.enter(S.MEASURE, f"{self._station.name}, {1e3 * depth:.2f} mm down")
        begin, end = self._window(self._span(*seen), search.measure_speed_m_s)
        await self._move(begin, depth)
        period = period_of(seen[0])
        judge = partial(fault_of, search=search)
        self._groups += 1
        for out, back in even_shares(search.passes, GOLDEN * self._groups):  # anew for each height
            after = (out * period, back * period)
            await self._pair("measure", begin, end, search.measure_speed_m_s, judge, after)

    async def _lift(self, why: str) -> None:
        await self.run.enter(S.LIFT, why)
        top = min(0.0, self._depth)
        await self._move(self._s, top)
        await self._move(0.0, top)

    # -- there and back

    async def _search_pair(
        self, phase: str, begin: float, end: float, speed: float, back_at: BackAt | None = None
    ) -> Pair:
        """What polls with gaps could not have seen, or a beam that stays broken, is taken again."""
        search = self.search
        return await self._pair(
            phase,
            begin,
            end,
            speed,
            lambda out, back: gap_of((out, back), search) or stuck_dark(out, back),
            back_at=back_at,
        )

    async def _pair(
        self,
        phase: str,
        begin: float,
        end: float,
        speed_m_s: float,
        judge: Judge,
        after_poll_s: tuple[float, float] = (0.0, 0.0),
        back_at: BackAt | None = None,
    ) -> Pair:
        speed = replace(self._speed, tcp_m_s=speed_m_s)
        station, beam = self._station, self._beams[self._station.beam]
        span = begin, end
        pair = await self._pairs.take(
            station, beam, self._depth, span, speed, judge, phase, after_poll_s, back_at
        )
        self._progress.count()
        return pair

    async def _move(self, s: float, depth: float) -> None:
        if abs(s - self._s) < SAME_M and abs(depth - self._depth) < SAME_M:
            return
        there = self._station.at(s, depth)
        await self._lease.move_linear(there)
        self._s, self._depth = s, depth
        await self.run.clock.sleep(self.search.settle_s)

    def _span(self, out: BeamPass, back: BeamPass) -> tuple[float, float]:
        """From the first edge to the last of both ways, m from the auxiliary point."""
        s = self._station.s_of(np.concatenate([out.edge_positions(), back.edge_positions()]))
        return float(np.min(s)), float(np.max(s))

    def _window(self, span: tuple[float, float], speed_m_s: float) -> tuple[float, float]:
        """The part of the way that holds the crossing, with room to get up to speed and to slow down."""
        lead = self.search.lead_m + speed_m_s**2 / (2.0 * self._speed.tcp_m_s2)
        return max(span[0] - lead, 0.0), min(span[1] + lead, self._station.distance_m)

    # -- what the beams say

    async def _dark(self) -> list[str]:
        """The beams that are broken now."""
        await self.run.take_step("look at the beams", lambda: self.inputs.wait_fresh(POLL_TIMEOUT_S))
        newest = present(self.inputs.inputs.last(), "sample of the inputs, though a fresh one came")
        return [name for name, beam in self._beams.items() if newest.value.levels[beam.index]]

    def _searched(self) -> str:
        begin, end = self._station.start, self._station.at(0.0, self._depth)
        high, low = (1e3 * float(self.course.tip(T)[2]) for T in (begin, end))
        return (
            f"{self._station.name} was not met from a height of the tool's point of {high:.1f} mm down to "
            f"{low:.1f} mm"
        )

    def _raise_missing(self) -> None:
        if len(self._missing) == len(BEAMS):
            raise error("LASER_TOOL_NOT_FOUND", "; ".join(self._missing.values()))
        for beam, text in self._missing.items():
            other = next(name for name in BEAMS if name != beam)
            raise error("LASER_BEAM_STUCK", f"{text}, while beam {other} was")


async def leave_fixture(run: Run, lease: MotionLease, course: Course) -> None:
    """Straight up first when the tool stands between the sensors."""
    if (above := way_out(course, (await run.arm_state()).T_base_flange)) is not None:
        run.note("decision", event="lifted first", why="the tool stood between the sensors")
        await lease.move_linear(above)
