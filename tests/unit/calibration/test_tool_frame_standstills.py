"""Ways that are off together: which they are, and that the covariance is that of such ways."""

import numpy as np
import pytest
from scipy.special import chdtri

from calibration.tool_frame.averaging import average, excess
from calibration.tool_frame.bounds import LateralModel, Rows
from calibration.tool_frame.posterior import posterior
from calibration.tool_frame.scene import Pass
from calibration.tool_frame.standstills import (
    as_they_are,
    fewer,
    in_a_row,
    one_by_one,
    together,
    unseen,
    widened,
)

SLIDE, SPEED = 1e-4, 0.02
MODEL = LateralModel(("xs", "ys"))
LABELS = [("xs", 0), ("xs", 1), ("ys", 0), ("ys", 1)]
Neighbours = list[tuple[int, int]]


def made(seed: int, pairs: int, rest_m: float) -> tuple[Rows, Neighbours, np.ndarray]:
    """Rows of ``pairs`` ways out and back across each beam in both sets by an arm that stands off by
    ``rest_m`` (m) at each standstill; and the true unknowns."""
    rng = np.random.default_rng(seed)
    truth = np.array([0.3e-3 * rng.normal(), *rng.normal(size=2) * 3e-4])
    edges = rng.normal(size=len(LABELS)) * 1e-3
    low, edge, X, source = [], [], [], []
    neighbours: Neighbours = []
    way = 0
    for current in (0.0, 1.0):
        for b in range(2):
            rest = rest_m * rng.normal(size=2 * pairs + 1)
            neighbours += [(way + k, way + k + 1) for k in range(2 * pairs - 1)]
            for k in range(2 * pairs):
                row = np.array([(-1.0) ** k * SPEED, -current * (b == 0), -current * (b == 1)])
                for number in (2 * b, 2 * b + 1):
                    seen = edges[number] + row @ truth + 0.5 * (rest[k] + rest[k + 1])
                    phase = rng.random() * SLIDE
                    low.append(np.floor((seen - phase) / SLIDE) * SLIDE + phase)
                    edge.append(number)
                    X.append(row)
                    source.append(way)
                way += 1
    start = np.array(low)
    ends = (start, start + SLIDE, 0.0 * start, np.array(edge), np.array(X), np.array(source))
    return Rows(*ends, LABELS), neighbours, truth


def squared_errors(rest_m: float, pairs: int, seeds: range) -> tuple[np.ndarray, np.ndarray]:
    """In units of the covariance, with ways taken one by one and with those of such ways; 3 is right."""
    alone, subject = [], []
    for seed in seeds:
        rows, neighbours, truth = made(seed, pairs, rest_m)
        fit = average(rows, MODEL)
        found = posterior(rows, MODEL, fit, excess(rows, fit.rest, np.ones(len(rows.low))), 768)
        cov, _ = as_they_are(rows, MODEL, found.cov, found.noise, neighbours)
        e = found.mean[:3] - truth
        alone.append(e @ np.linalg.solve(found.cov[:3, :3], e))
        subject.append(e @ np.linalg.solve(cov[:3, :3], e))
    return np.array(alone), np.array(subject)


def test_the_covariance_is_that_of_ways_that_share_their_standstills() -> None:
    alone, subject = squared_errors(6e-5, 6, range(30))
    assert np.mean(alone) > 5.0
    assert 1.8 < np.mean(subject) < 4.2
    assert np.mean(subject < chdtri(3, 0.05)) >= 0.85


def test_an_arm_that_repeats_perfectly_leaves_the_covariance_as_it_was() -> None:
    rows, neighbours, _ = made(3, 4, 0.0)
    fit = average(rows, MODEL)
    found = posterior(rows, MODEL, fit, 0.0, 768, known_noise=2e-7)
    subject = widened(rows, MODEL, found.cov, 2e-7, 2e-7, together(rows, neighbours), one_by_one(rows))
    assert np.sqrt(np.diag(subject)[:3]) == pytest.approx(np.sqrt(np.diag(found.cov)[:3]), rel=0.02)


def test_ways_that_are_off_each_by_itself_leave_it_as_it_was() -> None:
    rows, _, _ = made(4, 4, 4e-5)
    fit = average(rows, MODEL)
    found = posterior(rows, MODEL, fit, 3e-5, 768)
    sigma, known = found.noise.sigma, one_by_one(rows)
    subject = widened(rows, MODEL, found.cov, sigma, sigma, known, known)
    assert np.sqrt(np.diag(subject)) == pytest.approx(np.sqrt(np.diag(found.cov)), rel=1e-3)


def test_edges_of_a_way_are_nearly_one_and_those_of_the_next_way_half() -> None:
    rows, _, _ = made(0, 1, 0.0)
    subject = together(rows, [(0, 1)], 0.8)
    assert subject[:4, :4] == pytest.approx(
        np.array([[1, 0.8, 0.4, 0.4], [0.8, 1, 0.4, 0.4], [0.4, 0.4, 1, 0.8], [0.4, 0.4, 0.8, 1]])
    )
    assert not subject[:4, 4:].any()
    assert fewer(subject[:4, :4]) == pytest.approx(1.0 + 0.8**2 + 2 * 0.4**2)


def test_ways_are_in_a_row_where_one_begins_at_the_end_of_the_other() -> None:
    def way(begin: float, end: float, t: float, height: float = 0.0, current: bool = True) -> Pass:
        xyz = np.array([[begin, 0.0, height], [end, 0.0, height]])
        none = np.zeros(0)
        return Pass(0, current, "xs", 1, np.array([t, t + 1.0]), xyz, none, none.astype(bool))

    ways = {
        7: way(0.0, 0.01, 0.0),
        3: way(0.01, 0.0, 2.0),
        4: way(0.0, 0.01, 4.0, height=0.001),  # moved down before
        9: way(0.01, 0.0, 6.0, height=0.001),
        1: way(0.0, 0.01, 8.0, height=0.001, current=False),
    }
    assert in_a_row(ways) == [(7, 3), (4, 9)]


def test_noise_that_neighbours_have_in_common_is_missing_in_what_is_seen() -> None:
    rows, neighbours, _ = made(0, 3, 0.0)
    assert unseen(rows, np.eye(len(rows.low))) == pytest.approx(1.0)
    assert 1.05 < unseen(rows, together(rows, neighbours)) < 1.3
