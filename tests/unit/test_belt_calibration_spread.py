"""Intervals of a belt's scale when sightings share errors: of a frame, or of a place in the picture."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from calibration.belt.scale import BeltScale, fit_scale
from procedures.belt.calibration_rows import Rows, counts_at
from procedures.belt.calibration_spread import spread, with_camera

SCALE, WAY = 1.013e-4, np.array([0.9998, -0.02, 0.0]) / np.hypot(0.9998, 0.02)
ITEMS, SPACING, SEEN, RUNS = 9, 0.25, 1.1, 120
Made = Callable[[np.random.Generator, np.ndarray, np.ndarray], np.ndarray]


def seen(rng: np.random.Generator, error: Made) -> Rows:
    """Items pass a picture that is ``SEEN`` m long, a frame every 15 mm; ``error`` is along the belt, m."""
    rows = []
    for frame in range(70):
        travel = 0.015 * frame
        for item in range(ITEMS):
            x = travel - item * SPACING + 0.8
            if 0.0 < x < SEEN:
                rows.append((frame, travel / SCALE, item, x))
    frame, count, item, x = (np.array(column) for column in zip(*rows, strict=True))
    along = x + error(rng, frame, x)
    points = along[:, None] * WAY + rng.normal(0.0, 5e-5, (len(x), 3))
    return Rows(0.1 * frame, points, count, item)


def inside(error: Made) -> tuple[float, float, float]:
    """Shares of runs in whose interval the truth lies: with what is shared, and without; and their ratio."""
    wide, plain, ratio = [], [], []
    for seed in range(RUNS):
        rows = seen(np.random.default_rng(seed), error)
        answer = fit_scale(rows.points, rows.counts, rows.items)
        assert isinstance(answer, BeltScale)
        sure = spread(answer, rows)
        assert sure is not None
        assert answer.half_scale is not None
        off = abs(answer.m_per_count - SCALE)
        wide.append(off <= sure.half_scale)
        plain.append(off <= answer.half_scale)
        ratio.append(sure.half_scale / answer.half_scale)
    return float(np.mean(wide)), float(np.mean(plain)), float(np.median(ratio))


def test_independent_sightings_hardly_widen_the_interval() -> None:
    wide, plain, ratio = inside(lambda rng, frame, x: np.zeros(len(x)))
    assert plain > 0.88
    assert wide > 0.93
    assert ratio < 2.0


def test_an_error_that_a_whole_frame_shares_widens_it() -> None:
    wide, plain, _ = inside(lambda rng, frame, x: rng.normal(0.0, 1.5e-4, 70)[frame])
    assert plain < 0.85
    assert wide > 0.90


def test_what_the_camera_gets_wrong_over_the_picture_widens_it() -> None:
    def pattern(rng: np.random.Generator, frame: np.ndarray, x: np.ndarray) -> np.ndarray:
        # A line, which no sighting can show, as strong as each of three waves, which they do.
        u = 2.0 * x / SEEN - 1.0
        a, b, c, d = rng.normal(0.0, 1e-4, 4)
        return np.asarray(
            a * np.sqrt(3.0) * u + b * np.cos(np.pi * u) + c * np.cos(3 * u) + d * np.sin(5 * u)
        )

    wide, plain, _ = inside(pattern)
    assert plain < 0.4
    assert wide > 0.85


def test_a_camera_that_is_turned_and_too_far_away_is_inside_the_interval_that_asks_for_it() -> None:
    turn_95, share_95, inside = 5e-4, 6e-4, []
    for seed in range(RUNS):
        rng = np.random.default_rng(seed)
        rows = seen(rng, lambda rng, frame, x: np.zeros(len(x)))
        turned = Rotation.from_rotvec(rng.normal(0.0, turn_95 / 1.96, 3)).apply(rows.points)
        off = replace(rows, points=turned * (1.0 + rng.normal(0.0, share_95 / 1.96)))
        answer = fit_scale(off.points, off.counts, off.items)
        assert isinstance(answer, BeltScale)
        alone = spread(answer, off)
        assert alone is not None
        sure = with_camera(alone, answer, turn_95, share_95)
        beside = np.cross([0.0, 0.0, 1.0], WAY)
        inside.append(
            [
                abs(answer.m_per_count - SCALE) <= half.half_scale
                and abs(answer.direction @ beside) <= half.half_angle
                for half in (sure, alone)
            ]
        )
        d = answer.direction
        assert np.sqrt(d @ sure.cov @ d) >= np.sqrt(d @ alone.cov @ d)
    with_it, without = np.mean(inside, axis=0)
    assert with_it > 0.85  # of both at once; 0.9 is right
    assert without < 0.5


def test_late_stamps_of_counts_are_smoothed_out() -> None:
    rng = np.random.default_rng(3)
    sent = np.arange(800) * 0.005
    late = np.where(rng.random(800) < 0.1, rng.uniform(0.0, 0.012, 800), rng.uniform(0.0, 5e-4, 800))
    stamps = np.maximum.accumulate(sent + late)
    encoder = np.stack([stamps, np.floor(1500.0 * sent)], axis=1)
    times = np.linspace(0.5, 3.5, 60)
    off = np.array([n for n in counts_at(encoder, list(times), 0.005) if n is not None]) - 1500.0 * times
    plain = np.interp(times, encoder[:, 0], encoder[:, 1]) - 1500.0 * times
    assert len(off) == 60
    assert np.std(off) < 0.4 * np.std(plain)
