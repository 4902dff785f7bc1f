"""Changes of an input from its levels and its edge counter, judged against the true course of the input."""

from itertools import accumulate, pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.modbus_inputs.changes import ChangeCount, CounterJump

# How many times the input changes between one look and the next.
courses = st.lists(st.integers(0, 7), min_size=1, max_size=30)


def levels(first: bool, flips: list[int]) -> list[bool]:
    return [bool((first + n) % 2) for n in accumulate(flips, initial=0)]


def rises(first: bool, flips: list[int]) -> list[int]:
    """Rising edges up to each look."""
    return [(n + (not first)) // 2 for n in accumulate(flips, initial=0)]


@given(st.booleans(), courses, st.sampled_from([16, 32]), st.integers(0, 2**32 - 1))
def test_a_snapshot_of_level_and_counter_gives_every_change(
    first: bool, flips: list[int], width: int, start: int
) -> None:
    shown = [(start + n) % 2**width for n in rises(first, flips)]
    subject = ChangeCount(first, shown[0], width)
    for level, count, true in zip(levels(first, flips)[1:], shown[1:], list(accumulate(flips)), strict=True):
        subject.take(level, count, most=10.0)
        assert subject.changes == true
    assert subject.unseen == 0


@given(st.booleans(), courses, courses)
def test_a_level_read_after_its_counter_keeps_parity_and_order_and_ends_right(
    first: bool, between: list[int], gaps: list[int]
) -> None:
    """``gaps`` are the changes between the reading of the counter and that of the level in one poll."""
    pairs = [*zip(between, gaps, strict=False), (0, 0), (0, 0)]
    at_counter, at_level, total = [], [], 0
    for before, within in pairs:
        total += before
        at_counter.append(total)
        total += within
        at_level.append(total)
    subject = ChangeCount(first, 0)
    seen = [0]
    for counter_at, level_at in zip(at_counter, at_level, strict=True):
        subject.take(bool((first + level_at) % 2), (counter_at + (not first)) // 2, most=20.0)
        seen.append(subject.changes)
        assert subject.changes % 2 == level_at % 2
    assert all(b >= a for a, b in pairwise(seen))
    assert all(n <= true for n, true in zip(seen[1:], at_level, strict=True)), "never one too many"
    assert subject.changes == total
    assert subject.unseen == 0


@given(st.booleans(), courses)
def test_levels_alone_give_one_change_where_they_differ(first: bool, flips: list[int]) -> None:
    subject = ChangeCount(first, None)
    for n, (a, b) in enumerate(pairwise(levels(first, flips))):
        before = subject.changes
        subject.take(b, None, most=0.0)
        assert subject.changes - before == (a != b), n


@pytest.mark.parametrize(
    ("before", "after", "counted", "changed"),
    [(0, 0, 2, 4), (1, 1, 2, 4), (0, 1, 2, 3), (1, 0, 2, 5), (0, 1, 1, 1), (1, 0, 0, 1), (0, 0, 0, 0)],
)
def test_two_polls_and_n_rising_edges(before: int, after: int, counted: int, changed: int) -> None:
    subject = ChangeCount(bool(before), 5)
    subject.take(bool(after), 5 + counted, most=10.0)
    assert subject.changes == changed


def test_a_counter_that_goes_on_through_its_wrap_is_no_jump() -> None:
    subject = ChangeCount(False, 0xFFFE, width=16)
    subject.take(False, 1, most=5.0)
    assert subject.changes == 6


def test_a_counter_that_begins_again_is_a_jump_and_changes_nothing() -> None:
    subject = ChangeCount(False, 70000)
    with pytest.raises(CounterJump, match="from 70000 to 2"):
        subject.take(False, 2, most=30.0)
    assert subject.changes == 0


def test_an_edge_that_the_counter_owes_is_not_counted_twice() -> None:
    subject = ChangeCount(False, 0)
    subject.take(True, 0, most=10.0)
    subject.take(True, 1, most=10.0)
    assert (subject.changes, subject.unseen) == (1, 0)


def test_a_debt_of_the_counter_hides_no_pulse_of_a_later_poll() -> None:
    subject = ChangeCount(False, 0)
    subject.take(True, 0, most=10.0)  # never counted
    subject.take(True, 0, most=10.0)
    subject.take(True, 1, most=10.0)  # a pulse
    assert subject.changes == 3


def test_a_counter_that_stands_still_is_found_by_the_edges_that_it_does_not_show() -> None:
    subject = ChangeCount(False, 0)
    for level in (True, False, True, False, True, False):
        subject.take(level, 0, most=10.0)
    assert subject.changes == 6
    assert subject.unseen == 3
    subject.take(True, 1, most=10.0)
    assert subject.unseen == 0
