"""How far the true flange is off the reported one: a draw at each standstill, blended while moving."""

from bisect import bisect_right
from collections import deque
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from cell.poses import Array
from fakes.world.arm.kinematics import displacement
from fakes.world.arm.segments import Segment

REMEMBERED = 256


@dataclass(frozen=True, eq=False)
class Blend:
    """From one deviation to the next while the arm moves; deviations are (6,), m and rad."""

    start: float
    end: float
    before: Array
    after: Array

    def at(self, t: float) -> Array:
        now: Array = self.many(np.array([t]))[0]
        return now

    def many(self, times: Array) -> Array:
        """Deviations (n, 6) at ``times`` (n,)."""
        if self.end <= self.start:
            part = (times >= self.start).astype(float)[:, None]
        else:
            part = np.clip((times - self.start) / (self.end - self.start), 0.0, 1.0)[:, None]
        out: Array = (1.0 - part) * self.before + part * self.after
        return out

    @cached_property
    def turns(self) -> bool:
        """Whether the flange is off by a turn as well, and not by a shift alone."""
        return bool(self.before[3:].any() or self.after[3:].any())

    def rate(self, t: float, lever_m: float) -> float:
        """How fast (m/s) a point ``lever_m`` from the flange moves by this at ``t`` and later, at most."""
        if not self.start <= t < self.end:
            return 0.0
        change = self.after - self.before
        way = float(np.linalg.norm(change[:3]) + lever_m * np.linalg.norm(change[3:]))
        return way / (self.end - self.start)


class Repeatability:
    """The deviation of the flange as a function of time; a draw is a function of the seed and the move.

    A move that begins before another one has ended goes on from the deviation reached by then.
    """

    def __init__(self, seed: int, sigma_t: float, sigma_r: float) -> None:
        self._seed, self._sigma = seed, np.array([sigma_t] * 3 + [sigma_r] * 3)
        self._draw = lru_cache(REMEMBERED)(self._new_draw)
        first = self._draw(0)
        self._blends: deque[Blend] = deque([Blend(-np.inf, -np.inf, first, first)], maxlen=REMEMBERED)
        self._settled: tuple[Blend, Array] | None = None  # the last one that was over, and its end

    def add(self, segment: Segment) -> None:
        """The arm begins ``segment``; moves planned for later are forgotten."""
        while len(self._blends) > 1 and self._blends[-1].start >= segment.t0:
            self._blends.pop()
        if segment.settles:
            after = self._draw(round(segment.t0 * 1e6) + 1)
            self._blends.append(Blend(segment.t0, segment.t_end, self.at(segment.t0), after))

    def at(self, t: float) -> Array:
        """Deviation (6,), translation first, m and rad, in the flange."""
        return self.blend_at(t).at(t)

    def matrix(self, t: float) -> Array:
        """The deviation as a pose (4, 4), to be multiplied on the right of the flange's."""
        blend = self.blend_at(t)
        if t < blend.end:
            return displacement(blend.at(t))
        if self._settled is None or self._settled[0] is not blend:
            self._settled = blend, displacement(blend.at(t))
        return self._settled[1]

    def blend_at(self, t: float) -> Blend:
        """The blend in force at ``t``."""
        return self._blends[max(bisect_right(self._blends, t, key=lambda b: b.start) - 1, 0)]

    def history(self) -> list[Blend]:
        """What a mirror starts from."""
        return list(self._blends)

    def load(self, blends: list[Blend]) -> None:
        """Become a copy of the one whose :meth:`history` this is."""
        self._blends = deque(blends, maxlen=REMEMBERED)

    def _new_draw(self, key: int) -> Array:
        return self._sigma * np.random.default_rng([self._seed, key]).standard_normal(6)
