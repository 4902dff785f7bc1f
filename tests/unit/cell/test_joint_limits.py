"""Limits of single joints: how fast a joint move may be, and what a lease makes of it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cell.devices import Speed
from cell.joint_limits import leading_speed, limit_words, per_joint

SPEEDS = [0.5, 1.0, 2.0, 3.0, 3.0, 3.0]
turns = st.lists(st.integers(-6000, 6000), min_size=6, max_size=6).map(lambda mrad: 1e-3 * np.array(mrad))


@given(turns)
def test_the_leading_joint_is_as_fast_as_lets_each_keep_to_its_own_limit(turned: np.ndarray) -> None:
    leading = float(leading_speed(turned, np.array(SPEEDS)))
    farthest = float(np.abs(turned).max())
    if farthest == 0.0:
        assert leading == np.inf
        return
    speeds = leading * np.abs(turned) / farthest  # all begin and end together
    assert np.all(speeds <= np.array(SPEEDS) * (1.0 + 1e-9))
    assert np.any(speeds >= np.array(SPEEDS) * (1.0 - 1e-9)), "one of them is at its limit"


def test_many_moves_are_looked_at_together() -> None:
    moves = np.array([[1.0, 0, 0, 0, 0, 0], [0, 0, 0, 1.0, 0, 0], [0.5, 0, 0, 1.0, 0, 0], np.zeros(6)])
    assert leading_speed(moves, np.array(SPEEDS)).tolist() == [0.5, 3.0, 1.0, np.inf]


def test_one_number_is_the_limit_of_each_joint_to_the_last_bit() -> None:
    speed = Speed(0.25, 0.5, 0.7, 1.4, tuple(per_joint(0.7).tolist()))
    rng = np.random.default_rng(3)
    for _ in range(50):
        assert speed.between(rng.normal(size=6), rng.normal(size=6)).joint_rad_s == 0.7


def test_a_move_of_a_slow_joint_is_slowed_down_and_one_of_the_others_is_not() -> None:
    speed = Speed(0.25, 0.5, 3.0, 1.4, tuple(SPEEDS))
    here = np.zeros(6)
    assert speed.between(here, np.array([1.0, 0, 0, 0, 0, 0])).joint_rad_s == 0.5
    assert speed.between(here, np.array([0, 0, 0, 0, 0, 1.0])).joint_rad_s == 3.0
    assert Speed(0.25, 0.5, 3.0, 1.4).between(here, np.ones(6)).joint_rad_s == 3.0


@pytest.mark.parametrize(("limit", "text"), [(0.8, "0.8"), (SPEEDS, "[0.5, 1, 2, 3, 3, 3]")])
def test_a_limit_is_shown_as_it_is_written(limit: float | list[float], text: str) -> None:
    assert limit_words(limit) == text
