"""Sightings of items on a belt whose true motion is known, with errors that they share, or do not."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from calibration.belt.scale import BeltScale, fit_scale
from procedures.belt.calibrating.rows import SightingRows
from procedures.belt.calibrating.spread import spread

SCALE, WAY = 1.013e-4, np.array([0.9998, -0.02, 0.0]) / np.hypot(0.9998, 0.02)
BESIDE = np.cross([0.0, 0.0, 1.0], WAY)
SEEN, NOISE = 1.1, 5e-5  # m of the belt in the picture; m of a sighting, along each axis
Error = Callable[[np.random.Generator, np.ndarray, np.ndarray, np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Feed:
    """``items`` come ``spacing`` m apart; a picture is taken every ``step`` m."""

    items: int
    spacing: float
    frames: int
    step: float


MANY = Feed(9, 0.25, 70, 0.015)
USUAL = Feed(6, 0.35, 25, 0.0375)  # some 80 sightings, as the job takes by default
FEW = Feed(2, 0.35, 14, 0.04)


def nothing(rng: np.random.Generator, frame: np.ndarray, item: np.ndarray, x: np.ndarray) -> np.ndarray:
    return np.zeros(len(x))


def of_frames(rng: np.random.Generator, frame: np.ndarray, item: np.ndarray, x: np.ndarray) -> np.ndarray:
    """A count that is wrong moves all items of a frame."""
    return np.asarray(rng.normal(0.0, 1.5e-4, frame.max() + 1)[frame])


def of_items(rng: np.random.Generator, frame: np.ndarray, item: np.ndarray, x: np.ndarray) -> np.ndarray:
    """A height that is wrong draws an item out in proportion to its place in the picture."""
    return np.asarray(rng.normal(0.0, 1e-4, item.max() + 1)[item] * (x - 0.5 * SEEN))


def of_the_picture(
    rng: np.random.Generator, frame: np.ndarray, item: np.ndarray, x: np.ndarray
) -> np.ndarray:
    """A line, which no sighting can show, as strong as each of three waves, which they do."""
    u = 2.0 * x / SEEN - 1.0
    a, b, c, d = rng.normal(0.0, 3e-5, 4)
    return np.asarray(a * np.sqrt(3.0) * u + b * np.cos(np.pi * u) + c * np.cos(3 * u) + d * np.sin(5 * u))


def seen(
    rng: np.random.Generator, error: Error = nothing, feed: Feed = USUAL, along: float = NOISE
) -> SightingRows:
    """Items pass a picture; ``error`` (m) is along the belt, as is the noise ``along``."""
    frame, item = np.divmod(np.arange(feed.frames * feed.items), feed.items)
    x = feed.step * frame - feed.spacing * item + min(0.8, feed.spacing * (feed.items - 1))
    inside = (x > 0.0) & (x < SEEN)
    frame, item, x = frame[inside], item[inside], x[inside]
    points = (x + error(rng, frame, item, x) + rng.normal(0.0, along, len(x)))[:, None] * WAY
    others = rng.normal(0.0, NOISE, (len(x), 2))
    points += others[:, :1] * BESIDE + others[:, 1:] * np.cross(WAY, BESIDE)
    return SightingRows(0.1 * frame, points, feed.step * frame / SCALE, item)


@dataclass(frozen=True)
class Coverage:
    """Shares of runs whose 95 % intervals hold the true scale and direction, the share for the scale if
    sightings were independent, and the median half of the scale's as a multiple of 1.96 RMS errors."""

    scale: float
    angle: float
    plain: float
    width: float


def coverage(runs: int, error: Error = nothing, feed: Feed = USUAL, along: float = NOISE) -> Coverage:
    """Over ``runs`` seeds."""
    rows = []
    for seed in range(runs):
        data = seen(np.random.default_rng([seed, 5]), error, feed, along)
        answer = fit_scale(data.points, data.counts, data.items)
        assert isinstance(answer, BeltScale)
        assert answer.half_scale is not None
        sure = spread(answer, data)
        assert sure is not None
        off, turned = answer.m_per_count - SCALE, abs(float(answer.direction @ BESIDE))
        rows.append((off, sure.half_scale, answer.half_scale, turned <= sure.half_angle))
    off, half, plain, turned_within = np.array(rows).T
    return Coverage(
        scale=float(np.mean(np.abs(off) <= half)),
        angle=float(np.mean(turned_within)),
        plain=float(np.mean(np.abs(off) <= plain)),
        width=float(np.median(half) / (1.96 * np.sqrt(np.mean(off**2)))),
    )
