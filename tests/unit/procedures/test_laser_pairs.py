"""When each way across a beam begins between two polls."""

import numpy as np
import pytest

from procedures.laser.pairs import even_shares


@pytest.mark.parametrize("count", [1, 2, 3, 5, 8, 64])
def test_ways_fall_evenly_between_two_polls(count: int) -> None:
    shares = np.sort(np.ravel(even_shares(count, 0.3)))
    assert np.diff(shares) == pytest.approx(1.0 / (2 * count))
    assert shares[0] >= 0.0
    assert shares[-1] < 1.0


@pytest.mark.parametrize("count", [4, 5, 8, 64])
def test_ways_with_one_standstill_fall_far_apart(count: int) -> None:
    shares = np.ravel(even_shares(count, 0.3))
    apart = np.abs(np.diff(shares))
    assert np.min(np.minimum(apart, 1.0 - apart)) > 0.29
