"""Counts that come to a PC that pauses: what is believed of the belt's speed meanwhile."""

import numpy as np
import pytest

from calibration.belt.estimator import BeltEstimator, EncoderScale
from cell.poses import Array

PERIOD_S, M_PER_COUNT, FAST_M_S = 0.005, 1e-4, 0.2
STANDS_S, STARTS_S, PAUSES_S = 1.0, 1.4, 1.3


def stamps(t: Array, rng: np.random.Generator) -> Array:
    """Of frames sent at ``t``: each a little late, and from ``PAUSES_S`` on all at once after a pause of 20
    to 120 ms, some five times a second."""
    out, at = t + rng.exponential(0.0015, len(t)), PAUSES_S
    while at < t[-1]:
        awake = at + rng.uniform(0.02, 0.12)
        out = np.where((out > at) & (out < awake), awake, out)
        at = awake + rng.exponential(0.15)
    return np.maximum.accumulate(out)


@pytest.mark.parametrize("seed", [4, 7, 8, 18, 20])
def test_a_belt_that_starts_is_believed_no_speed_that_it_never_had(seed: int) -> None:
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 3.0, PERIOD_S)
    starting = np.clip(0.5 * (t - STARTS_S), 0.0, FAST_M_S)
    speed = np.where(t < STANDS_S, FAST_M_S, starting)
    counts = np.floor(np.cumsum(speed) * PERIOD_S / M_PER_COUNT).astype(int)
    subject, believed = BeltEstimator(EncoderScale(M_PER_COUNT, None, PERIOD_S)), list[float]()
    for stamp, count in zip(stamps(t, rng), counts, strict=True):
        subject.add(float(stamp), int(count))
        if stamp > STARTS_S + 0.1 and (found := subject.forecast()) is not None:
            believed.append(float(found.speed(found.now)))
    assert min(believed) > -0.6 * FAST_M_S
    assert max(believed) < 1.6 * FAST_M_S
    assert np.median(believed[-100:]) == pytest.approx(FAST_M_S, rel=0.05)
