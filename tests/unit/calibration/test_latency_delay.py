"""The delay of a switching input from crossings, on data made by sampling a moving edge."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.latency.crossings import SeenCrossing, solve_delay, undetermined
from calibration.latency.delay import Delay

PERIOD = 0.005
EDGES = (0.0101, 0.0173)  # m along the way


def crossings(
    seed: int,
    speeds: tuple[float, ...],
    passes: int,
    tau: float = 0.0031,
    hysteresis: float = 60e-6,
    answer: float = 0.0,
    looked: float = 0.5,
) -> list[SeenCrossing]:
    """Polls of a level that follows the arm ``tau`` late; it breaks later on the way in and clears later on
    the way out by half of ``hysteresis``. The module looks when ``looked`` of its ``answer`` (s) is over."""
    rng = np.random.default_rng(seed)
    out = []
    ways = [(speed, direction) for speed in speeds for direction in (1, -1) * passes]
    for way, (speed, direction) in enumerate(ways):
        phase = rng.uniform(0.0, PERIOD)
        for place, edge in enumerate(EDGES):
            switched = direction * (edge + direction * hysteresis / 2) / speed + tau
            after = np.ceil((switched - phase) / PERIOD) * PERIOD + phase
            seen = after - PERIOD / 2 + (0.5 - looked) * answer
            x = direction * speed * seen
            out.append(SeenCrossing(way, place, direction, speed, x, PERIOD / 2, answer / 2))
    return out


def solved(seed: int, **how: float) -> Delay:
    return solve_delay(crossings(seed, (0.01, 0.02, 0.05), 4, **how))


def test_delay_and_hysteresis_are_found_within_their_uncertainty() -> None:
    found = [solved(seed) for seed in range(200)]
    tau = np.array([(d.tau - 0.0031) / d.sigma_tau for d in found])
    hysteresis = np.array([(d.hysteresis - 60e-6) / d.sigma_hysteresis for d in found])  # type: ignore[operator]
    assert np.sqrt(np.mean(tau**2)) == pytest.approx(1.0, abs=0.15)
    assert np.sqrt(np.mean(hysteresis**2)) == pytest.approx(1.0, abs=0.15)
    covered = [d.interval95[0] < 0.0031 < d.interval95[1] for d in found]
    assert 0.92 < np.mean(covered) < 0.99  # never narrower than the brackets allow, so a little too often
    assert np.mean([d.scatter for d in found]) == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize("looked", [0.0, 1.0])
def test_the_interval_holds_wherever_between_request_and_reply_a_module_looks(looked: float) -> None:
    found = [solved(seed, answer=0.0024, looked=looked) for seed in range(100)]
    assert np.mean([d.tau for d in found]) == pytest.approx(0.0031 + (0.5 - looked) * 0.0024, abs=1e-4)
    assert found[0].bias == pytest.approx(0.0012)  # all of it, and no pass more narrows that
    covered = [d.interval95[0] < 0.0031 < d.interval95[1] for d in found]
    assert 0.92 < np.mean(covered) < 0.99


def test_an_answer_that_takes_no_time_widens_nothing() -> None:
    subject = solved(0)
    assert (subject.bias, subject.half95) == (0.0, subject.sigmas * subject.sigma_tau)
    assert solved(0, answer=1e-6).half95 == pytest.approx(subject.half95, rel=1e-3)


def test_edges_that_fall_alike_between_two_polls_count_once() -> None:
    twice = crossings(4, (0.01, 0.02, 0.05), 4)
    once = [c for c in twice if c.place == 0]
    alike = once + [replace(c, place=1) for c in once]
    assert solve_delay(alike).sigma_tau > 0.95 * solve_delay(once).sigma_tau


def test_with_one_speed_the_hysteresis_is_part_of_the_delay_and_that_is_said() -> None:
    subject = solve_delay(crossings(1, (0.02,), 20, hysteresis=80e-6))
    assert subject.hysteresis is None
    assert subject.tau == pytest.approx(0.0031 + 40e-6 / 0.02, abs=4 * subject.sigma_tau)


def test_one_way_alone_tells_nothing_and_neither_do_few_edges() -> None:
    all_of_them = crossings(2, (0.01, 0.05), 3)
    forward = [c for c in all_of_them if c.direction == 1]
    assert str(undetermined(forward)).startswith("one-way")
    assert str(undetermined(all_of_them[:4])).startswith("too-few-passes")
    with pytest.raises(ValueError, match="one-way"):
        solve_delay(forward)


def test_an_arm_that_is_not_where_it_says_widens_the_interval() -> None:
    rng = np.random.default_rng(3)
    clean = crossings(3, (0.01, 0.02, 0.05), 4)
    shaken = [replace(c, x=c.x + rng.normal(0.0, 2e-4)) for c in clean]
    assert solve_delay(shaken).sigma_tau > 2.0 * solve_delay(clean).sigma_tau
    assert solve_delay(shaken).scatter > 2.0
