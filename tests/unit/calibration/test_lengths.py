"""Lengths that normal errors stay below, beside draws."""

import numpy as np
import pytest
from scipy.special import chdtri

from calibration.lengths import length95, length_beyond, lengths95
from cell.poses import Array

CLOUDS = ((1.0, 1.0, 1.0), (1.0, 0.7, 0.7), (3.0, 1.0, 0.5), (1.0, 0.01, 0.01), (2.0, 2.0, 0.1))


def turned(sigmas: tuple[float, float, float]) -> Array:
    """A covariance (3, 3) with these standard deviations, along no axis."""
    Q, _ = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))
    return np.asarray(Q @ np.diag(np.square(sigmas)) @ Q.T)


def lengths_of(cov: Array, count: int) -> Array:
    draws = np.random.default_rng(4).multivariate_normal(np.zeros(3), cov, count)
    return np.asarray(np.linalg.norm(draws, axis=1))


@pytest.mark.parametrize("chance", [0.05, 1.0 / 300.0])
@pytest.mark.parametrize("sigmas", CLOUDS)
def test_as_many_draws_are_longer_as_were_asked_for_whatever_the_shape_of_the_cloud(
    sigmas: tuple[float, float, float], chance: float
) -> None:
    cov = turned(sigmas)
    beyond = np.mean(lengths_of(cov, 1_000_000) > length_beyond(cov, chance))
    assert beyond == pytest.approx(chance, abs=4.0 * np.sqrt(chance / 1_000_000))
    assert length_beyond(1e-12 * cov, chance) == pytest.approx(1e-6 * length_beyond(cov, chance))
    assert length95(cov) == pytest.approx(length_beyond(cov, 0.05), rel=0.005)


def test_round_and_flat_clouds_and_one_axis_have_the_quantiles_of_chi() -> None:
    for chance in (0.05, 1.0 / 300.0):
        for axes in (1, 2, 3):
            expected = np.sqrt(chdtri(axes, chance))
            cov = np.diag([1] * axes + [0] * (3 - axes))
            assert length_beyond(cov, chance) == pytest.approx(expected, rel=1e-4)
            for fewer in range(axes, 3):
                assert length_beyond(cov[:fewer, :fewer], chance) == pytest.approx(expected, rel=1e-4)
    assert length95(np.eye(3)) == pytest.approx(2.7955, abs=1e-4)


def test_of_many_each_is_as_of_one_and_no_uncertainty_has_no_length() -> None:
    cov = np.array([turned(sigmas) for sigmas in CLOUDS] + [np.zeros((3, 3))])
    assert lengths95(cov) == pytest.approx([length95(one) for one in cov])
    assert lengths95(cov)[-1] == 0.0
    assert lengths95(cov, 9.0)[-1] == 0.0


def test_what_is_no_covariance_has_no_length_that_could_be_taken_for_small() -> None:
    hole = np.eye(3)
    hole[0, 1] = np.nan
    cov = np.array([hole, np.full((3, 3), np.inf), -np.eye(3), np.diag([1.0, -0.5, 0.2]), np.eye(3)])
    for found in (lengths95(cov), [length_beyond(one, 0.01) for one in cov]):
        assert np.isnan(found).tolist() == [True, True, True, True, False]


@pytest.mark.parametrize("freedom", [4.0, 12.0, 60.0])
def test_a_length_from_few_degrees_of_freedom_holds_as_often_as_it_says(freedom: float) -> None:
    rng = np.random.default_rng(int(freedom))
    root = np.diag([3.0, 1.0, 0.5])
    size = rng.chisquare(freedom, 20_000) / freedom  # of the variance, as it was estimated
    off = np.linalg.norm(rng.normal(size=(20_000, 3)) @ root, axis=1)
    length = lengths95((root @ root)[None], freedom)
    assert np.mean(off < np.sqrt(size) * length) == pytest.approx(0.95, abs=0.01)
    assert lengths95((root @ root)[None], 1e9)[0] == pytest.approx(length95(root @ root), rel=1e-6)
