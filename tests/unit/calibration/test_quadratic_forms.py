"""The length that vectors of many normal numbers are beyond, beside quantiles and draws."""

import numpy as np
import pytest
from scipy.special import chdtri, fdtri

from calibration.lengths import length_beyond
from calibration.quadratic_forms import size_beyond

CHANCES = (0.3, 0.05, 1.0 / 300.0, 1e-6)


@pytest.mark.parametrize("chance", CHANCES)
@pytest.mark.parametrize("k", [1, 2, 3, 20])
def test_equal_variances_have_the_quantiles_of_chi(k: int, chance: float) -> None:
    variances = np.full(k, 4e-10)
    assert size_beyond(variances, chance) == pytest.approx(2e-5 * np.sqrt(chdtri(k, chance)), rel=0.01)
    expected = 2e-5 * np.sqrt(k * fdtri(k, 30.0, 1.0 - chance))
    assert size_beyond(variances, chance, 30.0) == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize("chance", CHANCES[1:3])
def test_unequal_variances_agree_with_what_is_exact_for_three_and_with_draws_of_many(chance: float) -> None:
    three = np.array([1.0, 0.3, 0.05])
    assert size_beyond(three, chance) == pytest.approx(length_beyond(np.diag(three), chance), rel=0.01)
    many = 0.7 ** np.arange(30)
    squares = np.random.default_rng(1).normal(size=(400_000, 30)) ** 2 @ many
    assert np.quantile(np.sqrt(squares), 1.0 - chance) == pytest.approx(size_beyond(many, chance), rel=0.015)


def test_axes_without_variance_count_nothing_and_half_is_near_the_median() -> None:
    assert size_beyond(np.zeros(6), 0.05) == 0.0
    assert size_beyond(np.array([1.0, 0.0, 2.0]), 0.05) == size_beyond(np.array([1.0, 2.0]), 0.05)
    assert size_beyond(np.ones(40), 0.5) == pytest.approx(np.sqrt(chdtri(40, 0.5)), rel=1e-3)
