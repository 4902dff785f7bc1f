"""Frames that no single encoder at its timer sends are noticed, and ordinary ones are not."""

import numpy as np
import pytest

from drivers.can_encoder.suspicions import Flood, TwoSenders

PERIOD_S = 0.005


@pytest.mark.parametrize("other", [0, 7, 3])
def test_two_nodes_on_one_identifier_are_seen_whatever_the_second_does(other: int) -> None:
    subject = TwoSenders()
    told = [subject.seen(10 * k if k % 2 else 50000 + other * k) for k in range(60)]
    assert any(told)


def test_a_belt_that_runs_stops_shakes_or_turns_back_is_one_sender() -> None:
    rng = np.random.default_rng(1)
    for speed in (0.0, 0.4, 30.0, 4000.0):
        subject, way = TwoSenders(), np.cumsum(np.full(2000, speed) * np.sin(np.arange(2000) / 100.0))
        shaken = way + rng.integers(-2, 3, 2000)
        assert not any(subject.seen(int(x)) for x in shaken), speed


def test_a_position_that_is_set_once_is_one_sender() -> None:
    subject = TwoSenders()
    assert not any(subject.seen(k if k < 100 else 50000 + k) for k in range(200))


def test_frames_by_the_timer_are_no_flood_and_those_with_every_count_are() -> None:
    by_timer, by_event = Flood(PERIOD_S), Flood(PERIOD_S)
    assert not any(by_timer.seen(k * PERIOD_S) for k in range(2000))
    told = [by_event.seen(k / 1500.0) for k in range(2000)]
    assert told[-1] == pytest.approx(1500.0, rel=0.01)


@pytest.mark.parametrize("stalled_s", [0.4, 1.5, 5.0])
def test_a_burst_after_a_stall_is_no_flood(stalled_s: float) -> None:
    subject = Flood(PERIOD_S)
    back = 1.0 + stalled_s
    times = [k * PERIOD_S for k in range(3000)]
    times = [t if not 1.0 < t < back else back for t in times]
    assert not any(subject.seen(t) for t in times)


def test_a_flood_is_one_also_after_a_stall() -> None:
    subject = Flood(PERIOD_S)
    before = [subject.seen(k * PERIOD_S) for k in range(200)]
    assert not any(before)
    told = [subject.seen(1.5 + k / 1500.0) for k in range(1500)]
    assert any(told), "within a second"


@pytest.mark.parametrize(("times", "within_s"), [(3.0, 2.1), (2.2, 10.1)])
def test_a_flood_is_told_the_later_the_less_it_is_one(times: float, within_s: float) -> None:
    subject = Flood(PERIOD_S)
    assert any(subject.seen(k * PERIOD_S / times) for k in range(round(within_s * times / PERIOD_S)))
