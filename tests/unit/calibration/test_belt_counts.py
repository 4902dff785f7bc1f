"""Counts: wrapping at the encoder's own range, misread frames, resets, and when they were taken."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calibration.belt.clock import FrameCounter, distinct, true_times
from calibration.belt.unwrap import Unwrapper


@settings(max_examples=60, deadline=None)
@given(
    modulus=st.integers(1000, 2**32),
    start=st.integers(0, 2**32),
    steps=st.lists(st.integers(-200, 200), min_size=1, max_size=60),
)
def test_counts_go_on_across_any_range(modulus: int, start: int, steps: list[int]) -> None:
    true = start % modulus + np.concatenate([[0], np.cumsum(steps)])
    subject = Unwrapper(modulus, fastest=60_000.0)
    found = [subject.add(0.005 * k, int(n) % modulus) for k, n in enumerate(true)]
    assert found == [int(n) for n in true]
    assert subject.resets == []


def test_a_long_gap_at_speed_is_bridged_with_the_speed_from_before() -> None:
    subject = Unwrapper(4096, fastest=50_000.0)
    for k in range(100):
        subject.add(0.005 * k, (20 * k) % 4096)
    far = 100 + 180  # 3600 counts later, nearer to the old count the other way round
    assert subject.add(0.005 * far, (20 * far) % 4096) == 20 * far


def test_one_misread_frame_is_left_out() -> None:
    subject = Unwrapper(2**25, fastest=50_000.0)
    counts = [10 * k for k in range(40)]
    counts[20] = 9_000_000
    found = [subject.add(0.005 * k, n) for k, n in enumerate(counts)]
    assert found[20] is None
    assert [n for k, n in enumerate(found) if k != 20] == [n for k, n in enumerate(counts) if k != 20]
    assert (subject.misread, subject.resets) == (1, [])


def test_a_reset_encoder_goes_on_from_where_the_belt_must_be() -> None:
    subject = Unwrapper(2**25, fastest=50_000.0)
    for k in range(100):
        subject.add(0.005 * k, 5_000_000 + 10 * k)
    found = [subject.add(0.005 * k, 10 * (k - 100)) for k in range(100, 140)]
    assert found[:2] == [None, None]
    assert found[-1] == pytest.approx(5_000_000 + 10 * 139, abs=10)
    assert len(subject.resets) == 1


def frames(seed: int, late: float, lost: float = 0.0, count: int = 1500) -> tuple[np.ndarray, np.ndarray]:
    """Instants of a sender, and its stamps with exponential lateness."""
    rng = np.random.default_rng(seed)
    instants = 0.005 * np.arange(count)[rng.uniform(size=count) >= lost]
    return instants, instants + rng.exponential(late, len(instants))


def numbered(stamps: np.ndarray, counts: np.ndarray) -> np.ndarray:
    counter = FrameCounter(0.005)
    return np.array([counter.add(float(t), float(n)) for t, n in zip(stamps, counts, strict=True)])


def test_stamps_with_jitter_are_brought_to_the_senders_rhythm() -> None:
    instants, stamps = frames(1, 4e-4, lost=0.02)
    n = np.floor(2000.0 * instants + 0.3)
    slots = numbered(stamps, n)
    timed = true_times(stamps, slots, n)
    off = timed.t - instants
    assert timed.share == pytest.approx(0.0, abs=0.02)
    assert np.ptp(off) < 1e-4  # the mean lateness is one with every latency; the jitter is gone
    assert np.ptp(stamps - instants) > 1e-3


def test_stamps_that_tell_the_truth_about_an_irregular_sender_are_kept() -> None:
    rng = np.random.default_rng(2)
    instants = 0.005 * np.arange(1500) + rng.uniform(-8e-4, 8e-4, 1500)
    n = np.floor(2037.0 * instants + 0.3)
    timed = true_times(instants, numbered(instants, n), n)
    assert timed.share == pytest.approx(1.0, abs=0.03)
    assert np.std(timed.t - instants) < 2e-5


def test_lost_frames_keep_their_numbers() -> None:
    instants, stamps = frames(3, 2e-4, lost=0.3)
    standing, moving = np.zeros(len(stamps)), np.floor(1500.0 * instants)
    for counts in (standing, moving):
        assert np.array_equal(np.diff(numbered(stamps, counts)), np.rint(np.diff(instants) / 0.005))


def test_frames_of_a_burst_after_a_stall_get_their_own_numbers_back() -> None:
    stamps = 0.005 * np.arange(200)
    stamps[100:106] = stamps[106]  # six frames held up, delivered at once
    assert np.array_equal(np.diff(distinct(numbered(stamps, np.zeros(200)))), np.ones(199))


def test_a_sender_of_another_period_than_nominal_is_followed() -> None:
    stamps = 0.0052 * np.arange(1500)
    assert np.array_equal(np.diff(numbered(stamps, np.zeros(1500))), np.ones(1499))


def test_a_reader_that_is_late_for_every_third_frame_still_finds_the_senders_rhythm() -> None:
    rng = np.random.default_rng(4)
    instants = 0.005 * np.arange(2400)
    n = np.floor(1500.0 * instants + 0.3)
    late = np.where(rng.uniform(size=2400) < 0.35, rng.uniform(0.0, 0.0049, 2400), 5e-5)
    late[::97] = 0.0112
    stamps = np.maximum.accumulate(instants + late)
    slots = numbered(stamps, n)
    for size in range(400, 2400, 53):  # whoever happens to be the newest
        timed = true_times(stamps[:size], slots[:size], n[:size])
        assert timed.share is not None
        assert np.abs(timed.t - instants[:size]).max() < 5e-4
