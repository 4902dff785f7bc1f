"""The encoder on a belt's shaft as a thing: what its position is, whatever the wire.

Every face shares it, so the faults of the encoder itself (slip, a wheel that stands, a position near its
wrap or frozen) live here; what can go wrong on a bus lives in the face.
"""

from bisect import bisect_right
from math import floor, inf

import numpy as np

from fakes.world.belt.belt import Belt
from fakes.world.belt.truth import BeltTruth

Slip = tuple[float, float, float]  # when, how far (m), for how long (s)


class BeltEncoder:
    """Positions as functions of time (s on the twin's clock).

    Faults begin at a time that is not before any that was asked for.
    """

    def __init__(self, truth: BeltTruth, belt: Belt, t0: float) -> None:
        self.truth, self.belt = truth, belt
        self.modulus = truth.modulus
        self._presets: list[tuple[float, float]] = [(-inf, truth.count_at_start + 0.5)]  # counts at travel 0
        self._slips: list[Slip] = []
        self._standing: list[tuple[float, float | None]] = [(-inf, None)]  # travel at which the wheel stands
        self._frozen: list[tuple[float, bool]] = [(-inf, False)]

    def told(self, t: float) -> float:
        """When the position was so that a message of ``t`` tells."""
        t -= self.truth.late_s
        if not self.truth.jitter_s:
            return t
        draw = np.random.default_rng([self.truth.node, round(1e6 * max(t, 0.0)), 0x717]).random()
        return t - self.truth.jitter_s * float(draw)

    def raw(self, t: float) -> int:
        """The position at ``t``, 0 to ``modulus - 1``."""
        return self.position(t) % self.modulus

    def position(self, t: float) -> int:
        """The same as if it never wrapped."""
        since, frozen = self._frozen[bisect_right(self._frozen, t, key=_when) - 1]
        return floor(self._counts(since if frozen else t))

    def speed(self, t: float) -> float:
        """Counts a second at ``t``, as the encoder's wheel turns."""
        if self._stands_at(t) is not None:
            return 0.0
        slipping = sum(d / span for begin, d, span in self._slips if begin <= t < begin + span)
        return (self.belt.speed_at(t) + slipping) / self.truth.m_per_count

    # -- faults

    def slip(self, t: float, distance_m: float, duration_s: float = 0.05) -> None:
        """From ``t`` on the wheel gets ahead of the belt by so much, within ``duration_s``."""
        self._slips.append((t, distance_m, max(duration_s, 1e-6)))

    def stick(self, t: float, stuck: bool) -> None:
        """From ``t`` on the wheel stands while the belt runs, or goes on from where it stood."""
        stands = self._stands_at(t)
        if stuck == (stands is not None):
            return
        if stands is None:
            self._standing.append((t, self._wheel(t)))
        else:
            self._standing.append((t, None))
            self._slips.append((t, stands - self._wheel(t), 1e-6))

    def freeze(self, t: float, frozen: bool) -> None:
        """From ``t`` on the encoder shows one position, or lives again."""
        if frozen != self._frozen[-1][1]:
            self._frozen.append((t, frozen))

    def preset(self, t: float, position: int) -> None:
        """At ``t`` the position becomes this one, and goes on from there."""
        now = self._travel(t) / self.truth.m_per_count
        self._presets.append((t, position + 0.5 - now))

    def wrap(self, t: float, before: int) -> None:
        """At ``t`` the position is set so that it wraps after ``before`` more counts as the belt now runs."""
        up = self.belt.speed_at(t) / self.truth.m_per_count >= 0.0
        self.preset(t, self.modulus - before if up else before - 1)

    def restart(self, t: float) -> None:
        """The encoder starts at ``t``; an incremental one has lost its position."""
        self.freeze(t, False)
        if not self.truth.keeps_position:
            self.preset(t, 0)

    def clear(self, t: float) -> None:
        """End every fault that lasts."""
        self.stick(t, False)
        self.freeze(t, False)

    # -- how it comes about

    def _counts(self, t: float) -> float:
        preset = self._presets[bisect_right(self._presets, t, key=_when) - 1][1]
        return self._travel(t) / self.truth.m_per_count + preset

    def _travel(self, t: float) -> float:
        stands = self._stands_at(t)
        return self._wheel(t) if stands is None else stands

    def _wheel(self, t: float) -> float:
        """Travel of the belt, and how far the wheel is ahead of it."""
        ahead = sum(d * min(max((t - begin) / span, 0.0), 1.0) for begin, d, span in self._slips)
        return self.belt.travel_at(t) + ahead

    def _stands_at(self, t: float) -> float | None:
        return self._standing[bisect_right(self._standing, t, key=_when) - 1][1]


def _when(event: tuple[float, object]) -> float:
    return event[0]
