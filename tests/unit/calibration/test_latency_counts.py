"""The delay of an encoder from sightings of items on a belt that is made to start and stop."""

import numpy as np
import pytest

from calibration.latency.counts import solve_counts
from calibration.latency.delay import Delay, DelayUndetermined

LATE_S, SCALE_M = 0.008, 1e-4


def belt(times: np.ndarray, steady: bool) -> np.ndarray:
    """Travel (m) of a belt at 0.15 m/s that stops for 1 s of every 4 s, with ramps of 0.25 s."""
    fine = np.arange(-1.0, times.max() + 1.0, 0.001)
    phase = np.mod(fine, 4.0)
    share = np.ones_like(fine) if steady else np.clip(np.abs(phase - 2.0) / 0.25 - 1.0, 0.0, 1.0)
    return np.interp(times, fine, np.cumsum(0.15 * share) * 0.001)


def found(seed: int, steady: bool = False, seconds: float = 60.0) -> Delay:
    rng = np.random.default_rng(seed)
    stamps = np.arange(0.0, seconds + 2.0, 0.005)
    counts = np.floor(belt(stamps - LATE_S, steady) / SCALE_M)
    rows = []
    shots = np.arange(0.5, seconds, 0.25)
    for t, travel in zip(shots, belt(shots, steady), strict=True):
        for k in range(-60, 3):
            along = travel + 0.3 * k
            if 0.0 < along < 0.7:
                pattern = 0.0005 * (along - 0.35) ** 2 / 0.35**2
                rows.append((t + 1e-4 * rng.standard_normal(), along + pattern, k))
    seen = np.array(rows)
    noise = 3e-4 * rng.standard_normal(len(seen))
    return solve_counts(seen[:, 0], seen[:, 1] + noise, seen[:, 2].astype(np.int64), stamps, counts)


def test_the_delay_is_found_within_what_is_stated() -> None:
    subject = found(1)
    low, high = subject.interval95
    assert low < LATE_S < high
    assert high - low < 0.002


def test_the_stated_interval_holds_as_often_as_it_says() -> None:
    inside = sum(low < LATE_S < high for low, high in (found(seed).interval95 for seed in range(6)))
    assert inside >= 4  # of 6 at 95 %: fewer has a chance of two in a thousand


def test_a_belt_at_one_speed_tells_nothing() -> None:
    with pytest.raises(DelayUndetermined, match=r"^steady-belt: .* start and stop it"):
        found(1, steady=True)


def test_a_handful_of_sightings_tells_nothing() -> None:
    with pytest.raises(DelayUndetermined, match=r"^too-few-sightings"):
        found(1, seconds=3.0)
