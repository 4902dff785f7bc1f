"""Between which heights the passes that hit and that missed leave the first contact: where the search for the
height begins, and which passes contradict all the others."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

_CONFLICT_M = 2e-4  # an arm that repeats badly hits and misses in turn, but not over so great a height


@dataclass(frozen=True, eq=False)
class HeightBracket:
    """The tool's point meets the beam between ``hit`` and ``miss`` (m, flange along the lift).

    ``assumed`` says that no pass went by clear of the tool's point, and the upper end is a guess from the
    hits' steps; ``blunders`` are the places of passes that do not count for it.
    """

    hit: float
    miss: float
    assumed: bool = False
    blunders: Sequence[int] = field(default_factory=tuple)

    @property
    def middle(self) -> float:
        return 0.5 * (self.hit + self.miss)

    @property
    def width(self) -> float:
        return abs(self.miss - self.hit)


def bracket(hits: Mapping[int, float], misses: Mapping[int, float]) -> HeightBracket | None:
    """The bracket from the flange heights (m) of the passes that hit and that missed, by their places.

    Passes that contradict most of the others, a trigger that was lost or came from something else, do not
    count. None without hits; and without misses where the hits have one height alone.
    """
    if not hits:
        return None
    if not misses:
        levels = np.unique(np.round(np.array(list(hits.values())), 6))
        if len(levels) < 2:
            return None
        gap = float(levels[-1] - levels[-2])
        return HeightBracket(float(levels[-1]), float(levels[-1]) + 4.0 * gap, assumed=True)
    edges = np.unique(np.array([*hits.values(), *misses.values()]))
    between = np.concatenate([[edges[0] - 1.0], 0.5 * (edges[1:] + edges[:-1]), [edges[-1] + 1.0]])
    hit, miss = np.array(list(hits.values())), np.array(list(misses.values()))
    wrong = np.sum(hit[:, None] > between, axis=0) + np.sum(miss[:, None] < between, axis=0)
    best = between[wrong == wrong.min()]
    c = float(best[len(best) // 2])
    blunders = [k for k, h in hits.items() if h > c + _CONFLICT_M]
    blunders += [k for k, h in misses.items() if h < c - _CONFLICT_M]
    good_hits = [h for k, h in hits.items() if k not in blunders]
    good_misses = [h for k, h in misses.items() if k not in blunders]
    if not good_hits or not good_misses:
        return None
    top, bottom = max(good_hits), min(good_misses)
    return HeightBracket(min(top, bottom), max(top, bottom), False, tuple(blunders))
