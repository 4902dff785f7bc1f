"""Which item a sighting belongs to, and what an item is made of."""

from math import pi

import numpy as np
import pytest

from procedures.belt.items import Item, Outcome, Queue

SPACING = 0.03


def seen(queue: Queue, *along: float, yaw: float = 0.0) -> list[Item]:
    """What one frame shows in the middle of the belt."""
    return queue.place(np.array([[x, 0.0] for x in along]).reshape(-1, 2), [yaw] * len(along))


def turned(*yaws: float) -> float:
    queue = Queue(SPACING)
    for yaw in yaws:
        (item,) = seen(queue, 0.1, yaw=yaw)
    return item.yaw


def test_one_sighting_turned_otherwise_does_not_turn_the_item() -> None:
    assert turned(0.30, 0.31, 0.29, 0.30, 1.2) == pytest.approx(0.30, abs=0.011)


def test_an_axis_has_no_sense_of_direction() -> None:
    found = turned(0.5 * pi - 0.02, 0.02 - 0.5 * pi, 0.5 * pi, 0.01 - 0.5 * pi, 0.5 * pi - 0.01)
    assert abs(np.sin(found - 0.5 * pi)) < 0.011


def test_an_item_as_long_as_wide_is_never_taken_across_its_corners() -> None:
    for k in range(1, 7):
        yaw = turned(*[0.3, 0.3 + 0.5 * pi, 0.3 - 0.5 * pi, 0.3, 0.3 + 0.5 * pi, 0.3][:k])
        assert abs(np.sin(2.0 * (yaw - 0.3))) < 1e-9


def test_an_item_that_turned_on_the_belt_is_believed_when_it_is_seen_so_again_and_again() -> None:
    assert turned(*[0.1] * 40, *[0.8] * 20) == pytest.approx(0.8)


def test_two_sightings_of_one_frame_are_two_items_however_close() -> None:
    queue = Queue(SPACING)
    for shake in (0.0, 2e-4, -1e-4):
        first, second = seen(queue, 0.125 + shake, 0.1 + shake)
        assert (first.number, second.number) == (1, 2)
    assert [(item.along, item.sightings) for item in queue.items] == [
        (pytest.approx(0.1249), 3), (pytest.approx(0.0999), 3)
    ]  # fmt: skip
    assert queue.seen == 2


def test_a_row_that_is_seen_a_little_off_keeps_its_order() -> None:
    queue = Queue(SPACING)
    seen(queue, 0.050, 0.025, 0.0)
    assert [item.number for item in seen(queue, 0.013, 0.063, 0.038)] == [3, 1, 2]


def test_a_sighting_within_the_spacing_of_what_was_picked_is_that_again() -> None:
    queue = Queue(SPACING)
    (item,) = seen(queue, 0.1)
    queue.end(item, Outcome.PICKED, 1.0)
    assert seen(queue, 0.11) == [item]
    assert queue.seen == 1


def test_the_neighbour_of_what_was_picked_stays_itself() -> None:
    queue = Queue(SPACING)
    first, second = seen(queue, 0.125, 0.1)
    queue.end(first, Outcome.PICKED, 1.0)
    assert seen(queue, 0.101) == [second]
    assert seen(queue, 0.124, 0.1) == [first, second]
    assert queue.waiting(1) == [second]


def test_a_frame_without_items_places_none() -> None:
    queue = Queue(SPACING)
    assert seen(queue) == []
    seen(queue, 0.1)
    assert seen(queue) == []
