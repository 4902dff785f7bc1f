"""The way back from targets: straight where it is free, else past where the arm stood before."""

from collections.abc import Callable
from typing import Any

import pytest

from cell.errors import RefusedError, error
from cell.poses import Array
from procedures.eye_to_hand import targets
from procedures.eye_to_hand.targets import way_back

HOME = [0.0] * 6
STOOD = [[float(k)] * 6 for k in (1, 2, 3)]


@pytest.fixture
def guarded(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """A guard that refuses the ways of which the first joints are named: from, to."""

    def refuse(*ways: tuple[int, int]) -> None:
        class Guard:
            def check_path_joints(self, q0: Array, q1: Array) -> None:
                if (way := (round(q0[0]), round(q1[0]))) in ways:
                    raise error("MOTION_COLLISION", f"from {way[0]} to {way[1]}")

        monkeypatch.setattr(targets, "lease_settings", lambda values: (Guard(), None, None))

    return refuse


def steps() -> int:
    values: Any = None
    return way_back(values, STOOD, HOME)


def test_a_free_way_is_straight(guarded: Callable[..., None]) -> None:
    guarded()
    assert steps() == 0


def test_it_goes_back_as_far_as_it_must(guarded: Callable[..., None]) -> None:
    guarded((3, 0))
    assert steps() == 1
    guarded((3, 0), (2, 0))
    assert steps() == 2


def test_without_a_way_it_says_what_is_in_the_straight_one(guarded: Callable[..., None]) -> None:
    guarded((3, 0), (2, 0), (1, 0))
    with pytest.raises(RefusedError, match="from 3 to 0"):
        steps()


def test_the_way_to_an_earlier_pose_is_checked_as_well(guarded: Callable[..., None]) -> None:
    guarded((3, 0), (3, 2))
    with pytest.raises(RefusedError, match="from 3 to 2"):
        steps()
