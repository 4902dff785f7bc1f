"""Errors beside their limits: how often good results are inside, by simulation."""

import numpy as np
import pytest
from scipy.special import chdtri

from procedures.beside_truth import (
    SURE_MODE,
    SURE_POINT,
    SURE_POSE,
    SURE_SCALAR,
    SURE_TILT,
    all_inside,
    limit_of_worst,
)

RUNS = 20000
RADIUS95 = float(np.sqrt(chdtri(3, 0.05)))


@pytest.mark.parametrize(
    ("degrees", "sure", "known"), [(3, SURE_POINT, 1.6435), (2, SURE_TILT, 1.7534), (1, SURE_SCALAR, 1.9850)]
)
def test_of_one_error_the_limits_are_its_own(degrees: int, sure: float, known: float) -> None:
    """By tables, of chi-square: 21.108, 18.421, 15.137 at 0.0001, and 7.815, 5.991, 3.841 at 0.05."""
    assert sure == pytest.approx(known, abs=1e-4)
    assert limit_of_worst(1, degrees) == 1.0
    assert limit_of_worst(1, degrees, sure=True) == sure


def test_a_pose_and_a_mode_are_called_wrong_at_the_same_level() -> None:
    assert pytest.approx((27.856, 3.8906), abs=1e-3) == (SURE_POSE, SURE_MODE)


@pytest.mark.parametrize("common", [0.0, 0.9])
def test_95_of_100_good_runs_have_their_worst_target_inside(common: float) -> None:
    """``common`` is the share of the variance that all targets of a run have from one error."""
    rng, n = np.random.default_rng(5), 16
    own, shared = rng.normal(size=(RUNS, n, 3)), rng.normal(size=(RUNS, 1, 3))
    worst = np.linalg.norm(np.sqrt(1.0 - common) * own + np.sqrt(common) * shared, axis=2).max(axis=1)
    share = worst / RADIUS95
    assert (share <= 1.0).mean() < 0.9, "each at its own 95 % is no limit for all"
    inside = (share <= limit_of_worst(n)).mean()
    assert inside >= 0.95 - 3.0 * np.sqrt(0.05 * 0.95 / RUNS)
    if not common:
        assert inside <= 0.951 + 3.0 * np.sqrt(0.05 * 0.95 / RUNS), "no wider than it has to be"


def test_where_nothing_is_stated_nothing_is_inside_or_outside() -> None:
    assert all_inside({}) is None
    assert all_inside({"one": 0.9, "other": 1.1}) is False
