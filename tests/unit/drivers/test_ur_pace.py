"""When set-points are due, beside a controller that takes one in each of its cycles."""

import numpy as np
import pytest

from drivers.ur.pace import SENT_AT, Pace

PERIOD = 0.002


def taken_by(sent: np.ndarray, cycles: np.ndarray) -> np.ndarray:
    """Of the set-points that had come by each cycle the last one's number."""
    return np.searchsorted(sent, cycles, side="right")


def sent_in(subject: Pace, late: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """When each was sent, so much ``late`` (n,) s, and the instant that it was for."""
    sent, instants = [], []
    for by in late.tolist():
        now = max(subject.due + by, sent[-1] if sent else 0.0)
        sent.append(now)
        instants.append(subject.take(now))
    return np.array(sent), np.array(instants)


@pytest.mark.parametrize("phase", np.arange(0.0, 1.0, 0.1).tolist())
def test_each_cycle_of_the_controller_finds_one_new_set_point(phase: float) -> None:
    subject = Pace(PERIOD)
    subject.begin(1.0 + phase * PERIOD)  # whenever the stream begins
    cycles = 1.0 + PERIOD * np.arange(1000)
    subject.keep_to(float(cycles[3]))
    jitter = np.random.default_rng(1).uniform(0.0, 0.6 * PERIOD, 900)
    sent, instants = sent_in(subject, jitter)
    new = np.diff(taken_by(sent, cycles[(cycles > sent[2]) & (cycles < sent[-1])]))
    assert set(new.tolist()) == {1}
    # Each is for an instant of its own, evenly, however late it was sent.
    assert np.diff(instants)[2:] == pytest.approx(np.full(len(instants) - 3, PERIOD), abs=1e-9)


def test_out_of_step_a_cycle_finds_none_and_the_next_leaps_over_two() -> None:
    """What it is for: the same rate and jitter, sent at the beginning of the cycles."""
    subject = Pace(PERIOD)
    subject.begin(1.0 - 0.3 * PERIOD)
    cycles = 1.0 + PERIOD * np.arange(1000)
    sent, _ = sent_in(subject, np.random.default_rng(1).uniform(0.0, 0.6 * PERIOD, 900))
    assert {0, 2} < set(np.diff(taken_by(sent, cycles[2:890])).tolist())


def test_set_points_that_were_missed_are_dropped() -> None:
    subject = Pace(PERIOD)
    subject.begin(1.0)
    subject.keep_to(1.0 - SENT_AT * PERIOD)
    assert subject.take(1.0) == 1.0
    assert subject.take(1.0 + 4.4 * PERIOD) == pytest.approx(1.0 + 4.0 * PERIOD)
    assert subject.due == pytest.approx(1.0 + 5.0 * PERIOD)


@pytest.mark.parametrize("shift", np.arange(-0.9, 1.0, 0.2).tolist())
def test_a_shift_of_the_controllers_cycle_is_followed_without_a_leap(shift: float) -> None:
    subject = Pace(PERIOD)
    subject.begin(1.0)
    subject.keep_to(1.0)
    first = subject.take(subject.due)
    second = subject.take(subject.due)
    subject.keep_to(1.0 + shift * PERIOD)
    third, fourth = subject.take(subject.due), subject.take(subject.due)
    steps = np.diff([first, second, third, fourth]) / PERIOD
    assert steps.min() >= 0.5 - 1e-9
    assert steps.max() <= 1.5 + 1e-9
    assert (fourth - 1.0) / PERIOD - shift - SENT_AT == pytest.approx(
        round((fourth - 1.0) / PERIOD - shift - SENT_AT)
    )
