"""Ways that are off together: which they are, and that the covariance is that of such ways."""

import numpy as np
import pytest
from scipy.special import chdtri

from calibration.tool_frame.averaging import average, excess, of_ways
from calibration.tool_frame.bounds import LateralModel, Rows
from calibration.tool_frame.posterior import posterior
from calibration.tool_frame.scene import Pass
from calibration.tool_frame.standstills import alternating, in_a_row, of_edges, of_standstills

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


def squared(error: np.ndarray, cov: np.ndarray) -> float:
    """Of the unknowns without the edges, in units of their covariance; 3 is right."""
    return float(error[:3] @ np.linalg.solve(cov[:3, :3], error[:3]))


def test_the_covariance_is_that_of_ways_that_share_their_standstills() -> None:
    alone, subject, plain, of_plain = [], [], [], []
    for seed in range(30):
        rows, neighbours, truth = made(seed, 6, 6e-5)
        fit = average(rows, MODEL)
        noise = excess(rows, fit.rest, np.ones(len(rows.low)))
        fit = average(rows, MODEL, None, noise)
        by_ways = posterior(rows, MODEL, fit, noise, 768)
        found = posterior(rows, MODEL, fit, noise, 768, neighbours=neighbours)
        alone.append(squared(by_ways.mean[:3] - truth, by_ways.cov))
        subject.append(squared(found.mean[:3] - truth, found.cov))
        plain.append(squared(fit.psi - truth, fit.cov))
        of_plain.append(
            squared(fit.psi - truth, of_ways(fit, rows, MODEL, of_edges(rows.source, neighbours)))
        )
    assert np.mean(alone) > 5.0
    assert 1.8 < np.mean(subject) < 4.2
    assert np.mean(np.array(subject) < chdtri(3, 0.05)) >= 0.85
    assert np.mean(plain) > 5.0
    assert 1.8 < np.mean(of_plain) < 4.5


def test_an_arm_that_repeats_perfectly_leaves_the_covariance_as_it_was() -> None:
    rows, neighbours, _ = made(3, 4, 0.0)
    fit = average(rows, MODEL)
    alone, subject = (
        posterior(rows, MODEL, fit, 0.0, 4096, known_noise=2e-7, neighbours=known)
        for known in ((), neighbours)
    )
    assert np.sqrt(np.diag(subject.cov)[:3]) == pytest.approx(np.sqrt(np.diag(alone.cov)[:3]), rel=0.05)


def test_edges_that_are_off_each_by_itself_leave_the_covariance_of_averaging_as_it_was() -> None:
    rows, neighbours, _ = made(3, 4, 0.0)
    fit = average(rows, MODEL, None, 3e-5)
    alone = of_ways(fit, rows, MODEL, np.eye(len(rows.low)))
    assert alone == pytest.approx(fit.cov, rel=1e-6, abs=1e-18)
    together = of_ways(fit, rows, MODEL, of_edges(rows.source, neighbours))
    assert np.all(np.diag(together)[1:3] > np.diag(alone)[1:3]), "where the tool is across the beams"


def test_edges_of_a_way_are_nearly_one_and_those_of_the_next_way_half() -> None:
    rows, _, _ = made(0, 1, 0.0)
    subject = of_edges(rows.source, [(0, 1)])
    assert subject[:4, :4] == pytest.approx(
        np.array([[1, 0.9, 0.45, 0.45], [0.9, 1, 0.45, 0.45], [0.45, 0.45, 1, 0.9], [0.45, 0.45, 0.9, 1]])
    )
    assert not subject[:4, 4:].any()


def test_every_way_is_off_by_its_own_standstills_alike_on_the_whole() -> None:
    half = float(np.sqrt(0.5))
    subject = of_standstills([3, 5, 8, 9], [(3, 5), (5, 9), (9, 11)])
    assert subject.T.tolist() == [
        pytest.approx([half, 0.0, 0.0, 0.0]),
        pytest.approx([half, half, 0.0, 0.0]),
        pytest.approx([0.0, half, 0.0, half]),
        pytest.approx([0.0, 0.0, 0.0, half]),
        pytest.approx([0.0, 0.0, 1.0, 0.0]),
    ]
    for own in alternating(subject):
        assert np.max(np.sum(subject[:, own] > 0.0, axis=1)) <= 1
    assert sorted(k for own in alternating(subject) for k in own) == [0, 1, 2, 3, 4]


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


def test_ways_of_both_sets_may_have_been_taken_at_the_same_times_of_two_clocks() -> None:
    ways = {}
    for k in range(4):
        for current in (False, True):
            begin, end = (0.0, 0.01) if k % 2 == 0 else (0.01, 0.0)
            xyz = np.array([[begin, 0.0, 0.0], [end, 0.0, 0.0]])
            t = np.array([k, k + 0.5]) + 0.3 * current
            none = np.zeros(0)
            ways[2 * k + current] = Pass(0, current, "xs", 1, t, xyz, none, none.astype(bool))
    assert in_a_row(ways) == [(0, 2), (2, 4), (4, 6), (1, 3), (3, 5), (5, 7)]
