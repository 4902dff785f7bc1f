"""Windows over the newest counts, and counts that lie apart, against the plain way to compute them."""

import numpy as np
import pytest

from calibration.belt.clock import strays
from calibration.belt.fit import Judge, Tail, line_and_bend

JUDGE = Judge(0.35, 0.005)


def counts(frames: int, bend: float) -> tuple[np.ndarray, np.ndarray]:
    s = 0.005 * np.arange(1 - frames, 1)
    return s, np.round(2e5 + 1503.7 * s + bend * s * s)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize(("frames", "bend"), [(7, 0.0), (60, 40.0), (2400, 0.0), (2400, 300.0)])
def test_a_window_is_the_least_squares_fit_of_its_frames(frames: int, bend: float, order: int) -> None:
    s, n = counts(frames, bend)
    window = Tail(s, n, JUDGE).longest(order)
    s, n = s[-window.frames :], n[-window.frames :]
    V = np.vander(s, order + 1, increasing=True)
    assert window.ok
    assert window.c == pytest.approx(np.linalg.lstsq(V, n, rcond=None)[0], rel=1e-7)
    assert window.cov == pytest.approx(JUDGE.sigma**2 * np.linalg.inv(V.T @ V), rel=1e-7)
    assert window.length == pytest.approx(-s[0])


def test_a_window_ends_where_the_belt_changed_its_speed() -> None:
    s, n = counts(400, 0.0)
    n = np.where(s < -0.5, n + np.round(700.0 * (s + 0.5)), n)
    window = Tail(s, n, JUDGE).longest(1)
    assert 0.25 < window.length <= 0.55
    assert window.c[1] == pytest.approx(1503.7, rel=1e-3)


def test_a_parabola_is_looked_for_only_where_no_line_goes_through_all_frames() -> None:
    line, bend = line_and_bend(*counts(400, 0.0), JUDGE)
    assert line is bend
    line, bend = line_and_bend(*counts(400, 300.0), JUDGE)
    assert bend.order == 2
    assert bend.length > 1.6 * line.length


def test_frames_with_one_stamp_tell_a_place_and_no_speed() -> None:
    window = Tail(np.full(5, -0.01), np.array([7.0, 8.0, 9.0, 9.0, 10.0]), JUDGE).longest(2)
    assert not window.ok
    assert window.c.tolist() == [10.0, 0.0, 0.0]
    assert window.cov[0, 0] > 1e9


def test_counts_that_lie_apart_are_those_off_the_median_of_nine() -> None:
    rng = np.random.default_rng(4)
    t, n = counts(600, 50.0)
    wrong = rng.choice(600, 90, replace=False)  # often several of nine
    n[wrong] += rng.choice([-30.0, -5.0, 5.0, 30.0], 90)
    expected = np.zeros(600, dtype=bool)
    speed = (n[16:] - n[:-16]) / (t[16:] - t[:-16])
    for k in range(4, 596):
        here = slice(k - 4, k + 5)
        v = speed[min(max(k - 8, 0), len(speed) - 1)]
        expected[k] = abs(n[k] - np.median(n[here] - v * (t[here] - t[k]))) > 2.0 + 6.0 * 0.35
    assert strays(t, n, 0.35).tolist() == expected.tolist()
    assert 30 < expected.sum() < 120
