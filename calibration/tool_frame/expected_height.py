"""How well the height of the tool's end will be known, before anything moves: by searches that are made up.

No simple formula holds: how long a break must be for polls to see it sets how deep a pass may be that
misses, and what the lengths of breaks tell of the end's shape. So a search goes as the job's does, with polls
at random phases and an arm that scatters, a few times and always the same, and through the estimator itself.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from calibration.tool_frame.glimpse import Glimpse, glimpse, plain_hit
from calibration.tool_frame.height import Density, first_contact, weights
from calibration.tool_frame.height_search import HeightSearch, Next, sought, upright
from calibration.tool_frame.repeatability import UNDER_WAY, PassScatter, scatter_of
from calibration.tool_frame.tip import ENDS, POINT, TipShape

_SEARCHES = 8
_FINEST_M = 1e-8  # of an arm that repeats perfectly
_SEEN = 0.2  # of the logarithm of the scatter, which the edges across the beams tell
_CENTRE_M, _CENTRE_KNOWN_M = 1e-4, 2e-4  # of a break: how far off its middle is, and is believed to be
_BESIDE = 0.8  # of the chord, on both sides of the beam


@dataclass(frozen=True)
class SearchPlan:
    """How a height is looked for.

    ``fast`` and ``slow`` (m/s) are the speeds, ``period_s`` is the time between two polls, ``pairs`` how many
    ways there and back there are at most, ``step`` (m) between the heights where the beam was clear and was
    broken, ``enough`` (m) the standard deviation that ends it. ``chord`` (m) is how long the tool breaks the
    beam, ``fingers`` that several of its parts do.
    """

    fast: float
    slow: float
    period_s: float
    pairs: int
    step: float
    enough: float
    chord: float
    fingers: bool = False


@dataclass(frozen=True)
class ExpectedHeight:
    """Variance (m^2) of a comparison of heights, and of one by a tool whose end is of a known shape."""

    variance: float
    known_end: float


@lru_cache(maxsize=64)  # three jobs and the cards of all tools ask for the same ones
def expected_height(plan: SearchPlan, noise_m: float) -> ExpectedHeight:
    """Of a tool with a flat end, which is told worst: polls that are far apart see no difference between it
    and one of no known shape, that may be missed deep down. ``noise_m`` is what a way scatters by."""
    rng = np.random.default_rng(815)
    noise = max(noise_m, _FINEST_M)
    scatter = scatter_of(noise / UNDER_WAY, noise, _SEEN)
    searches = [_searched(rng, plan, noise) for _ in range(_SEARCHES)]
    truths = [truth for _, truth in searches]
    view = upright(plan.chord)
    unknown, known = (
        _variance(
            [first_contact(s, view, ends, scatter, 0.0, plan.step) for s, _ in searches],
            truths,
            ends,
            scatter,
        )
        for ends in (POINT if plan.fingers else ENDS, POINT)
    )
    return ExpectedHeight(unknown, min(known, unknown))


def _searched(rng: np.random.Generator, plan: SearchPlan, noise: float) -> tuple[list[Glimpse], float]:
    """The ways of one search, and the height (m) that it looks for: up to a step above its first hit."""
    scatter = scatter_of(noise / UNDER_WAY)
    search = HeightSearch(
        0.0, plan.step, plan.chord, plan.fingers, scatter, plan.fast, plan.slow, plan.period_s
    )
    truth = plan.step * float(rng.random())
    seen: list[Glimpse] = []
    found = sought(search, [])
    while len(seen) < 2 * plan.pairs and found.sigma > plan.enough:
        rest = noise / UNDER_WAY * rng.normal(size=3)  # at each standstill
        off = 0.5 * (rest[:-1] + rest[1:])
        out = _way(rng, plan, found.next, truth - off[0], len(seen))
        then = sought(search, [out], found.belief).next
        back = _way(rng, plan, then, truth - off[1], len(seen) + 1)
        seen += [out, back]
        found = sought(search, [out, back], found.belief)
    return seen, truth


def _way(rng: np.random.Generator, plan: SearchPlan, then: Next, end: float, number: int) -> Glimpse:
    """One way at the height of ``then``, with an arm whose tool is met below ``end`` (m)."""
    slide = then.speed * plan.period_s
    polls = np.arange(-_BESIDE * plan.chord, _BESIDE * plan.chord + slide, slide) - slide * rng.random()
    middle = _CENTRE_M * rng.normal()
    dark = (np.abs(polls - middle) < 0.5 * plan.chord) & (then.height < end)
    if plan.fingers and dark.any():
        return plain_hit(then.height, number)
    return glimpse(then.height, number, polls, dark, 0.0, _CENTRE_KNOWN_M)


def _variance(
    heights: Sequence[Density], truths: Sequence[float], ends: Sequence[TipShape], scatter: PassScatter
) -> float:
    """Of a comparison that half of all stay below, m^2: each beam's height now against that of the reference,
    and the two beams by how well each knows it, as in :mod:`calibration.tool_frame.rise`."""
    found, n = [], len(heights)
    for first in range(n):
        four = [(heights[(first + k) % n], truths[(first + k) % n]) for k in range(4)]
        evidence = np.sum([h.evidence for h, _ in four], axis=0)
        z = np.stack([h.mean - truth for h, truth in four])
        apart = z[2:] - z[:2]
        var = np.stack([four[k + 2][0].var + four[k][0].var for k in range(2)])
        together = 1.0 / np.sum(1.0 / var, axis=0)
        spread = np.sum(var, axis=0)
        evidence = evidence - 0.5 * ((apart[0] - apart[1]) ** 2 / spread + np.log(spread))
        w = weights(evidence, ends, scatter)
        mean = together * np.sum(apart / var, axis=0)
        found.append(float(np.sum(w * (together + (mean - np.sum(w * mean)) ** 2))))
    return float(np.median(found))
