"""Ways across a beam near the end of a tool whose height is known: a search in height without a cell."""

from collections.abc import Callable, Sequence

import numpy as np

from calibration.tool_frame.glimpse import Glimpse, glimpse
from calibration.tool_frame.height_search import HeightSearch, Sought, sought
from calibration.tool_frame.repeatability import scatter_of
from calibration.tool_frame.tip import TipShape, ToolInBeam

CHORD_M = 0.007
ROUND_END, FLAT_END = TipShape("ball", 1.0, 1.0, 2e-5), TipShape("point", 1.0)
RIMMED_END = TipShape("flat", 1.0, band=5e-5, rim=5.5e-4)  # as a beam of 0.5 mm sees a flat end
UP = np.array([0.0, 0.0, 1.0])
VIEW = ToolInBeam(-UP, np.array([0.0, 1.0, 0.0]), UP, np.array([0.0, 1.0, 0.0]), 0.5 * CHORD_M, CHORD_M)
End = TipShape | Callable[[float], float]  # a shape, or the length of the break (m) by the depth (m)
FAST, SLOW, PERIOD_S = 0.05, 0.02, 0.005


def stepped(depth: float) -> float:
    """A thin pin in the middle of a thicker one."""
    return 0.0 if depth <= 0.0 else 0.45 * CHORD_M if depth < 1e-3 else CHORD_M


def polls(rng: np.random.Generator, speed: float, gap: tuple[float, float] | None = None) -> np.ndarray:
    """Places (n,) m of polls along the way, about zero; none in ``gap`` (m)."""
    at = np.arange(-0.012, 0.012, speed * PERIOD_S) + speed * PERIOD_S * rng.random()
    return at if gap is None else at[(at <= gap[0]) | (at >= gap[1])]


def crossed(
    rng: np.random.Generator,
    end: End,
    depth: float,
    height: float,
    pair: int,
    speed: float = SLOW,
    gap: tuple[float, float] | None = None,
    unsure: float = 0.0,
) -> Glimpse:
    """One way whose tool truly is ``depth`` (m) below the first contact, with the flange at ``height``; its
    chord is known to ``unsure`` (m)."""
    places = polls(rng, speed, gap)
    length = end(depth) if callable(end) else float(VIEW.lengths((end,), np.array([depth]))[0, 0])
    half = 0.5 * length
    middle = 1e-4 * rng.normal()
    return glimpse(height, pair, places, np.abs(places - middle) < half, 0.0, 2e-4, unsure=unsure)


def pairs_at(
    rng: np.random.Generator,
    end: End,
    truth: float,
    heights: Sequence[float],
    sigma: float,
    speed: float = SLOW,
) -> list[Glimpse]:
    """Ways out and back at each of ``heights`` (m) with an arm that repeats to ``sigma`` (m) a way."""
    found = []
    for k, h in enumerate(heights):
        rest = sigma * np.sqrt(2.0) * rng.normal(size=3)  # at each standstill
        for a, b in ((rest[0], rest[1]), (rest[1], rest[2])):
            found.append(crossed(rng, end, truth - h - 0.5 * (a + b), h, k, speed))
    return found


def searched(
    rng: np.random.Generator,
    end: End,
    sigma: float,
    most: int = 8,
    step: float = 5e-3,
    longer: float = 0.0,
    unsure: float = 0.0,
) -> tuple[Sought, float]:
    """A whole search, and the true height; the first hit is up to ``step`` (m) below it. The chord is taken
    to be ``longer`` (m) than it is, and known to ``unsure`` (m)."""
    truth = step * float(rng.random())
    scatter, chord = scatter_of(sigma * np.sqrt(2.0)), CHORD_M + longer
    search = HeightSearch(0.0, step, chord, False, scatter, FAST, SLOW, PERIOD_S)
    seen: list[Glimpse] = []
    found = sought(search, seen)
    for k in range(2 * most):  # the way back has a height of its own, and a standstill before it
        then = found.next
        depth = truth - then.height - sigma * float(rng.normal())
        seen.append(crossed(rng, end, depth, then.height, k, then.speed, unsure=unsure))
        found = sought(search, seen)
    return found, truth
