"""The covariance by leaving out observations, against solving again without each of them."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.adjustment.components import Components
from calibration.adjustment.equations import Observations, Prior
from calibration.adjustment.hand_eye import adjust
from calibration.adjustment.jackknife import Jackknife, at_least, by_chance, checked, jackknife
from calibration.adjustment.unknowns import ArmKnown
from calibration.hand_eye import se3
from calibration.hand_eye.solution import Solution, solve
from tests.kit.imperfect_cell import ARM, CAMERA, MODEL, capture, world

COMPONENTS = Components({"sigma_flange_t": 1.0}, {}, frozenset())


def problem(n: int = 9, unknowns: int = 7) -> tuple[Observations, Prior]:
    rng = np.random.default_rng(4)
    half = rng.normal(size=(n, 6, 6))
    obs = Observations(
        rng.normal(size=(n, 6)),
        rng.normal(size=(n, 6, unknowns)),
        rng.normal(size=(n, 6, 6)),
        np.arange(n) % 2,
        (half @ np.swapaxes(half, 1, 2) + 6.0 * np.eye(6))[None],
        np.zeros((unknowns, unknowns)),
        np.zeros(unknowns),
        0.0,
        0.0,
    )
    return obs, Prior(np.zeros(unknowns), np.array([np.inf] * 6 + [0.5] * (unknowns - 6)), {})


def without(obs: Observations, row: int) -> Observations:
    keep = np.arange(obs.n) != row
    rows = {key: getattr(obs, key)[keep] for key in ("r", "of_global", "of_local", "group")}
    return replace(obs, **rows, parts=obs.parts[:, keep])


def test_it_is_that_of_solving_again_without_each_observation() -> None:
    obs, prior = problem()
    at = np.zeros(7)
    x, w = COMPONENTS.equations(obs, prior, at).step()
    moved = obs.r + obs.of_global @ x + np.einsum("nij,nj->ni", obs.of_local, w[obs.group])
    solved = replace(obs, r=moved)
    eq = COMPONENTS.equations(solved, prior, x)
    assert np.abs(eq.step()[0]).max() < 1e-9, "at the solution"
    left = np.array(
        [COMPONENTS.equations(without(obs, row), prior, at).step()[0][:6] for row in range(obs.n)]
    )
    left -= left.mean(axis=0)
    expected = (obs.n - 1) / obs.n * left.T @ left
    np.testing.assert_allclose(jackknife(solved, COMPONENTS, eq, 6).cov, expected, rtol=1e-6)


def test_a_direction_beyond_chance_is_enlarged_to_it_and_no_other() -> None:
    cov = np.diag([1.0, 4.0, 1.0, 1.0, 1.0, 1.0])
    even = np.broadcast_to(cov / 100, (100, 6, 6))
    found = checked(cov, Jackknife(np.diag([1.5, 400.0, 0.1, 1.0, 1.0, 1.0]), even))
    np.testing.assert_allclose(found.cov, np.diag([1.0, 400.0, 1.0, 1.0, 1.0, 1.0]))
    assert found.largest == pytest.approx(10.0)
    assert not checked(cov, Jackknife(1.5 * cov, even)).added.any()
    assert checked(cov, Jackknife(1.5 * cov, even), 9.0).cov == pytest.approx(9.0 * cov)
    open_ = np.diag([np.inf, 1.0, 1.0, 1.0, 1.0, 1.0])
    assert not checked(open_, Jackknife(cov, even)).added.any()


@pytest.mark.parametrize("uneven", [0.0, 1.0])
@pytest.mark.parametrize("n", [20, 60, 200])
def test_chance_alone_is_beyond_the_limit_as_seldom_as_stated(n: int, uneven: float) -> None:
    """Sums of squares of normal numbers, drawn here with other numbers: one set of a thousand is beyond."""
    rng = np.random.default_rng(n)
    shares = np.exp(uneven * rng.normal(size=n))
    shares /= shares.sum()
    limit = by_chance(shares[:, None, None] * np.eye(6))
    x = np.sqrt(shares)[:, None] * rng.normal(size=(4000, n, 6))
    top = np.linalg.eigvalsh(np.swapaxes(x, 1, 2) @ x)[:, -1]
    beyond = top > limit
    assert np.count_nonzero(top > 0.92 * limit) >= 6, "the limit is no higher than chance asks for"
    assert np.count_nonzero(beyond) <= 16  # 4 are to be expected, and the limit is good to half of them
    if not uneven:
        assert at_least(n, 6) == pytest.approx(limit, rel=0.15)
    else:
        assert at_least(n, 6) < limit


@pytest.mark.parametrize("worse_m", [0.0, 1e-2])
@pytest.mark.parametrize("seed", range(4))
def test_the_stated_covariance_bears_two_bad_poses_and_is_not_enlarged_without_need(
    seed: int, worse_m: float
) -> None:
    rng = np.random.default_rng([seed, 7])
    cell = world(rng, 0.0, "exact", "exact")
    measured, Q = capture(rng, cell, "small")
    F = measured.F.copy()
    F[[3, 11], :3, 3] += worse_m * rng.normal(size=(2, 3))
    measured = replace(measured, F=F)
    first = solve(measured, CAMERA, {})
    assert isinstance(first, Solution)
    everything = replace(first, used=np.ones(len(first.used), dtype=bool))  # as if none had been left out
    found = adjust(measured, everything, CAMERA, ArmKnown(MODEL, Q, ARM.joint_limits))
    error = se3.log(se3.inverse(found.X) @ cell.X)
    assert error @ np.linalg.solve(found.cov, error) < 22.5, "one of 1000 errors is farther off"
    np.testing.assert_allclose(sum(found.budget.values()), np.diag(found.cov), rtol=1e-6)
    if worse_m == 0.0:
        assert not found.by_leaving_out.added.any()
        assert 0.3 < found.by_leaving_out.largest < found.by_leaving_out.limit
