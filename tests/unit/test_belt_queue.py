"""Which item a sighting belongs to, and what an item is made of."""

from math import pi

import numpy as np
import pytest

from procedures.belt.items import Item, Queue

SPACING = 0.03


def seen(queue: Queue, *places: float, yaw: float = 0.0) -> list[Item]:
    return [queue.place(along, 0.0, yaw) for along in places]


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
