"""The height that a scan looks for: from ways across the beam to where the next one goes."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from calibration.tool_frame.glimpse import Glimpse, glimpse, plain_hit
from calibration.tool_frame.height import ABOVE_M
from calibration.tool_frame.height_search import Belief, HeightSearch, Next, Sought, sought, upright
from calibration.tool_frame.repeatability import scatter_of
from calibration.tool_frame.tip import UPRIGHT
from cell.poses import Array
from cell.procedure import Worker
from procedures.laser.config import Search
from procedures.laser.path import BeamStation
from procedures.laser.sweep import BeamPass

_LENGTH95_OF_ALIKE = 2.8  # standard deviations of each of three axes that are known alike
_RARE = 0.001  # that all ways at a height miss a tool that is there
_CENTRE_M = 3e-4  # how far the middle of a break may be off that of the crossing further down


class SoughtHeight:
    """What the ways at one station say of the height (m, minus the depth) of the first contact.

    It is met at the depth ``hit`` (m). ``tried`` are the ways that found that, by their depths; ``located``
    is a way out and back well below, ``sigma_m`` one axis of the arm by its data sheet, ``max_U_m`` how far
    off 95 % of the points may be. ``worker`` computes.
    """

    def __init__(
        self,
        worker: Worker,
        search: Search,
        sigma_m: float,
        max_U_m: float,
        hit: float,
        tried: Sequence[tuple[float, BeamPass]],
        located: tuple[BeamPass, BeamPass],
        station: BeamStation,
    ) -> None:
        self._worker = worker
        self._offset = float(station.s_of(np.zeros(1))[0])
        ways = [Crossed.of(way) for way in located]
        self._fingers = search.edges > 2
        self._centre, apart = centre_of(ways)
        self._centre_sigma, self._span = _CENTRE_M + 0.5 * apart, span_of(ways)
        chord, self._unsure = chord_of(ways)
        self._lead = search.lead_m
        self._enough = height_goal(search.z_resolution_m, max_U_m)
        self._new: list[Glimpse] = []
        self._ways = 0
        self._belief: Belief | None = None
        for depth, way in tried:
            self.add(depth, way)
        self._seek = HeightSearch(
            -hit,
            clear_of(-hit, self._new, chord, search.descend_step_m),
            chord,
            self._fingers,
            scatter_of(sigma_m),
            search.search_speed_m_s,
            search.measure_speed_m_s,
            period_of(located[0]),
        )

    def add(self, depth: float, way: BeamPass) -> None:
        """A way at ``depth`` (m) that counts from now on."""
        self._new += self._of(way, self._ways, depth)
        self._ways += 1

    async def look(self, *more: tuple[float, BeamPass]) -> Sought:
        """What all ways say, and ``more`` (depth in m and way) that may yet be taken again."""
        seen = [g for depth, way in more for g in self._of(way, self._ways, depth)]
        found = await self._worker.call(sought, self._seek, [*self._new, *seen], self._belief)
        if not more:
            self._belief, self._new = found.belief, []
        return found

    def known(self, now: Sought) -> bool:
        """Whether it is known as well as asked for."""
        return now.sigma <= self._enough

    def span(self, then: Next) -> tuple[float, float]:
        """What the next way has to cross, m along the way."""
        # Begun or ended beside a tool that is wider than expected, a way would show nothing.
        half = max(0.5 * (self._span if self._fingers else then.longest), 0.5 * self._span - 0.5 * self._lead)
        middle = self._centre + self._offset
        return middle - half, middle + half

    def _of(self, way: BeamPass, pair: int, depth: float) -> list[Glimpse]:
        if way.begins_dark or way.ends_dark:
            return []
        if self._fingers and way.triggered:
            return [plain_hit(-depth, pair)]
        places = np.maximum.accumulate(way.direction * way.along(np.array([p.t for p in way.polls])))
        dark = np.array([p.value.levels[way.beam.index] for p in way.polls])
        dt = np.array([p.dt for p in way.polls])
        # What even the quickest reply takes is the same for all polls.
        soft = float(np.median(dt) - np.min(dt)) * abs(way.speed_at(float(np.mean(way.t))))
        pulse = None
        if (seen := way.edges()) and not dark.any():
            ends = way.direction * way.along(np.array([seen[0].t - seen[0].dt, seen[0].t + seen[0].dt]))
            pulse = (float(ends[0]), float(ends[1]))
        sigma = self._centre_sigma + (0.5 * self._span if self._fingers else 0.0)
        centre = way.direction * self._centre
        return [glimpse(-depth, pair, places, dark, centre, sigma, soft, pulse, unsure=self._unsure)]


@dataclass(frozen=True, eq=False)
class Crossed:
    """The edges of one way well below the tool's end: ``places`` (k,) m along the way out, in its order, each
    known to ``half`` (k,) m to both sides."""

    places: Array
    half: Array

    @classmethod
    def of(cls, way: BeamPass) -> Self:
        half = [e.dt * abs(way.speed_at(e.t)) for e in way.edges()][:: way.direction]
        return cls(way.edge_positions(), np.array(half))


def chord_of(ways: Sequence[Crossed]) -> tuple[float, float]:
    """How long the beam is broken (m), of fingers by the first alone, and how far off that may be (m): what
    all ways allow, as a late poll makes a single one much longer or shorter."""
    lengths = np.array([way.places[1] - way.places[0] for way in ways])
    half = np.array([way.half[0] + way.half[1] for way in ways])
    low, high = float(np.max(lengths - half)), float(np.min(lengths + half))
    if low > high:  # by what the arm scatters
        low, high = high, low
    return 0.5 * (low + high), 0.5 * (high - low)


def centre_of(ways: Sequence[Crossed]) -> tuple[float, float]:
    """The middle of what breaks the beam, m along the way out, mostly by the way that shows it best; and how
    far apart the ways have it (m), by late polls or by a delay that is not known."""
    middles = [0.5 * (way.places[0] + way.places[-1]) for way in ways]
    weights = [1.0 / ((way.half[0] + way.half[-1]) ** 2 + 1e-12) for way in ways]
    return float(np.average(middles, weights=weights)), float(np.ptp(middles))


def span_of(ways: Sequence[Crossed]) -> float:
    """m from the first edge to the last: the longest that a way showed."""
    return float(max(way.places[-1] - way.places[0] for way in ways))


def clear_of(hit: float, seen: Sequence[Glimpse], chord: float, step_m: float) -> float:
    """The lowest height (m) above ``hit`` at which the tool, of that ``chord`` (m), was surely clear of the
    beam: the polls of a quick way may miss a tool that is well below its first contact. Where ``seen`` has
    none, a step ``step_m`` above the highest."""
    shortest = float(np.min(upright(chord).lengths(UPRIGHT, np.array([ABOVE_M]))))
    missed: dict[float, float] = {}
    for one in seen:
        if one.height > hit:
            missed[one.height] = missed.get(one.height, 1.0) * float(one.at(np.array(shortest)))
    trusted = [height for height, chance in missed.items() if chance < _RARE]
    return min(trusted, default=max([hit, *missed]) + step_m)


def height_goal(z_resolution_m: float, max_U_m: float) -> float:
    """The standard deviation (m) at which a search for the height ends. Of two beams and two sets of passes
    the answer is as good as one height."""
    return min(z_resolution_m / float(np.sqrt(12.0)), max_U_m / _LENGTH95_OF_ALIKE)


def period_of(way: BeamPass) -> float:
    """The usual time between two polls, s."""
    return float(np.median(np.diff([p.t for p in way.polls])))
