"""Scales that data tell: what a set of unknowns is worth, and observations that are held as sums."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.adjustment.components import (
    SCALE_FACTOR,
    Components,
    estimated,
    evidence,
    with_mean_scales,
)
from calibration.adjustment.equations import Observations, Prior
from cell.poses import Array

PRIOR = Prior(np.zeros(8), np.array([*np.full(4, 0.5), *np.full(4, 0.2)]), {"second": slice(4, 8)})
AT = np.full(8, 0.1)


def data(seed: int = 1, n: int = 40) -> tuple[Array, Array, Array]:
    """Residuals (n, 3) with noise of 0.3, derivatives by eight numbers, and by a pose without a prior."""
    rng = np.random.default_rng(seed)
    of_global, of_local = rng.normal(size=(n, 3, 8)), rng.normal(size=(n, 3, 6))
    x = AT - rng.normal(size=8) * [*np.full(4, 0.5), *np.full(4, 0.6)]
    return of_global @ x + 0.3 * rng.normal(size=(n, 3)), of_global, of_local


def one_by_one(parts: Array | None = None) -> Observations:
    r, of_global, of_local = data()
    shape = np.broadcast_to(np.eye(3), (1, len(r), 3, 3)) if parts is None else parts
    group = np.zeros(len(r), dtype=np.int64)
    return Observations(r, of_global, of_local, group, shape, np.zeros((8, 8)), np.zeros(8), 0.0, 0.0)


def as_sums() -> tuple[Observations, Prior, Array]:
    r, of_global, of_local = data()
    A = np.concatenate([of_global, of_local], axis=2).reshape(-1, 14).T
    prior = Prior(np.zeros(14), np.append(PRIOR.sigma, np.full(6, np.inf)), PRIOR.blocks)
    return Observations.of_sums(A, r.ravel()), prior, np.append(AT, np.zeros(6))


def components(**least: float) -> Components:
    free = frozenset(["noise", "second"])
    return Components({"noise": 1.0}, {"second": 1.0}, free, least=least, of_sums="noise")


def test_evidence_is_the_density_of_the_observations_where_no_pose_takes_part() -> None:
    r, of_global, _ = data()
    obs = Observations.of_sums(of_global.reshape(-1, 8).T, r.ravel())
    worth = []
    for noise, scale in ((0.3, 1.0), (0.2, 3.0), (0.5, 0.3)):
        subject = Components({"noise": noise}, {"second": scale}, frozenset(), of_sums="noise")
        A, sigma = of_global.reshape(-1, 8), PRIOR.scaled({"second": scale}).sigma
        V = noise**2 * np.eye(len(A)) + (A * sigma**2) @ A.T
        y = r.ravel() - A @ AT
        density = -0.5 * np.linalg.slogdet(V)[1] - 0.5 * y @ np.linalg.solve(V, y)
        beforehand = -0.5 * (np.log(scale) / np.log(SCALE_FACTOR)) ** 2
        worth.append(evidence(obs, PRIOR, AT, subject) - density - beforehand)
    np.testing.assert_allclose(worth, worth[0], atol=1e-8)


def test_observations_say_the_same_one_by_one_and_as_sums() -> None:
    single, (sums, prior, at) = one_by_one(), as_sums()
    found = [estimated(single, PRIOR, AT, components()), estimated(sums, prior, at, components())]
    for subject in found:
        assert 0.25 < subject.sigma["noise"] < 0.35
        assert 1.5 < subject.scale["second"] < 5.0
    assert abs(found[0].sigma["noise"] / found[1].sigma["noise"] - 1.0) < 1e-2
    assert abs(found[0].scale["second"] / found[1].scale["second"] - 1.0) < 2e-2
    gains = [
        evidence(obs, by, to, found[0]) - evidence(obs, by, to, components())
        for obs, by, to in ((single, PRIOR, AT), (sums, prior, at))
    ]
    assert abs(gains[0] - gains[1]) < 1e-6 * abs(gains[0])


def test_a_scale_that_is_found_is_the_most_likely_one() -> None:
    sums, prior, at = as_sums()
    found = estimated(sums, prior, at, components())
    best = evidence(sums, prior, at, found)
    for name, factor in (("noise", 1.2), ("noise", 0.8), ("second", 1.5), ("second", 0.6)):
        sigma = {"noise": found.sigma["noise"] * (factor if name == "noise" else 1.0)}
        scale = {"second": found.scale["second"] * (factor if name == "second" else 1.0)}
        other = Components(sigma, scale, frozenset(), of_sums="noise")
        assert evidence(sums, prior, at, other) < best


def test_noise_does_not_fall_below_what_was_given() -> None:
    sums, prior, at = as_sums()
    assert estimated(sums, prior, at, components(noise=0.7)).sigma["noise"] == np.float64(0.7)


def test_a_scale_that_few_numbers_tell_enters_covariances_by_the_mean_of_its_square() -> None:
    """Against the density of the scale's logarithm, summed over it: the likeliest scale states too little."""
    obs = one_by_one()
    noise_known = replace(components(), free=frozenset(["second"]))
    found = estimated(obs, PRIOR, AT, noise_known)
    theta = np.linspace(-8.0, 8.0, 801) + 2.0 * np.log(found.scale["second"])
    worth = np.array(
        [evidence(obs, PRIOR, AT, replace(found, scale={"second": float(np.exp(0.5 * t))})) for t in theta]
    )
    density = np.exp(worth - worth.max())
    squared = float(np.sum(density * np.exp(theta)) / np.sum(density))
    subject = with_mean_scales(obs, PRIOR, AT, found)
    assert subject.scale["second"] > 1.02 * found.scale["second"]
    assert subject.scale["second"] == pytest.approx(np.sqrt(squared), rel=0.15)
    assert subject.sigma == found.sigma
    assert with_mean_scales(obs, PRIOR, AT, replace(found, free=frozenset())) == replace(
        found, free=frozenset()
    )
