"""The height that a scan looks for: from ways across the beam to where the next one goes."""

import numpy as np

from calibration.tool_frame.glimpse import Glimpse, glimpse, plain_hit
from calibration.tool_frame.height_search import Belief, HeightSearch, Next, Sought, sought
from calibration.tool_frame.repeatability import scatter_of
from cell.procedure import Worker
from procedures.laser.config import Search
from procedures.laser.path import BeamStation
from procedures.laser.sweep import BeamPass

_LENGTH95_OF_ALIKE = 2.8  # standard deviations of each of three axes that are known alike
_CENTRE_M = 3e-4  # how far the middle of a break may be off that of the crossing further down


class SoughtHeight:
    """What the ways at one station say of the height (m, minus the depth) of the first contact.

    It is between ``hit`` and ``clear``; ``located`` is a way out and back well below, ``sigma_m`` one axis of
    the arm by its data sheet, ``max_U_m`` how far off 95 % of the points may be. ``worker`` computes.
    """

    def __init__(
        self,
        worker: Worker,
        search: Search,
        sigma_m: float,
        max_U_m: float,
        hit: float,
        clear: float,
        located: tuple[BeamPass, BeamPass],
        station: BeamStation,
    ) -> None:
        self._worker = worker
        self._offset = float(station.s_of(np.zeros(1))[0])
        edges = [way.edge_positions() for way in located]
        self._centre = float(np.mean([0.5 * (e[0] + e[-1]) for e in edges]))
        self._fingers = search.edges > 2
        self._span = float(np.mean([e[-1] - e[0] for e in edges]))
        chord = float(np.mean([e[1] - e[0] for e in edges])) if self._fingers else self._span
        self._lead = search.lead_m
        self._enough = height_goal(search.z_resolution_m, max_U_m)
        self._new: list[Glimpse] = []
        self._ways = 0
        self._belief: Belief | None = None
        self._seek = HeightSearch(
            hit,
            clear,
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
        sigma = _CENTRE_M + (0.5 * self._span if self._fingers else 0.0)
        return [glimpse(-depth, pair, places, dark, way.direction * self._centre, sigma, soft, pulse)]


def height_goal(z_resolution_m: float, max_U_m: float) -> float:
    """The standard deviation (m) at which a search for the height ends. Of two beams and two sets of passes
    the answer is as good as one height."""
    return min(z_resolution_m / float(np.sqrt(12.0)), max_U_m / _LENGTH95_OF_ALIKE)


def period_of(way: BeamPass) -> float:
    """The usual time between two polls, s."""
    return float(np.median(np.diff([p.t for p in way.polls])))
