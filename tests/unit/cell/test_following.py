"""An arm that is not on the way that it was sent, or runs it slower than sent, ends the stream."""

from dataclasses import replace

import numpy as np
import pytest

from cell.devices import ArmState, TrajectoryPiece
from cell.errors import CellError
from cell.following import LIMIT_RAD, MOST_LAG_S, Following, require_full_speed
from cell.poses import Array
from cell.samples import Sample, Stream
from fakes.object.clock import VirtualClock

STEP_S, SPEED = 0.02, np.array([0.5, 0.0, -0.3, 0.0, 0.0, 1.0])
ZERO = np.zeros(6)
STATE = ArmState(ZERO, ZERO, ZERO, ZERO, ZERO, 7, 1, True, 0, 0, 0.0)


class Streamed:
    """Pieces of a steady way, beside an arm that is where ``q`` says."""

    def __init__(self) -> None:
        self._states: Stream[ArmState] = Stream("arm", VirtualClock())
        self.subject, self._k = Following("arm", self._states), 0

    def step(self, q: Array, scaling: float = 1.0) -> None:
        t = STEP_S * self._k
        self._states.push(Sample(replace(STATE, q=q, speed_scaling=scaling), t, 0.001, self._k))
        self.subject.sent(TrajectoryPiece(t, t + 0.15, np.array([t * SPEED, SPEED])))
        self._k += 1


@pytest.mark.parametrize("late_s", [0.0, 0.05, 0.2, MOST_LAG_S - STEP_S])
def test_an_arm_that_is_late_follows(late_s: float) -> None:
    cell = Streamed()
    for k in range(100):
        cell.step(max(STEP_S * k - late_s, 0.0) * SPEED)


def test_an_arm_that_is_held_does_not_follow() -> None:
    cell = Streamed()
    with pytest.raises(CellError, match=r"rad from every set-point") as caught:
        for _ in range(100):
            cell.step(ZERO)
    assert caught.value.name == "ARM_NOT_FOLLOWING"


def test_an_arm_beside_its_way_does_not_follow() -> None:
    cell, aside = Streamed(), np.array([0.0, 2.0 * LIMIT_RAD, 0.0, 0.0, 0.0, 0.0])
    for k in range(20):
        cell.step(STEP_S * k * SPEED)
    with pytest.raises(CellError) as caught:
        cell.step(20 * STEP_S * SPEED + aside)
        cell.step(21 * STEP_S * SPEED + aside)
    assert caught.value.name == "ARM_NOT_FOLLOWING"


def test_a_controller_that_slows_down_on_the_way_ends_the_stream() -> None:
    cell = Streamed()
    with pytest.raises(CellError, match="50 %") as caught:
        for k in range(20):
            cell.step(STEP_S * k * SPEED, 0.5 if k > 10 else 1.0)
    assert caught.value.name == "ARM_SPEED_SCALED"


def test_a_limiter_that_touches_for_a_cycle_ends_nothing() -> None:
    cell = Streamed()
    for k in range(40):
        cell.step(STEP_S * k * SPEED, 0.9 if k % 4 == 0 else 1.0)


def test_full_speed_is_required_in_words() -> None:
    require_full_speed("arm", STATE)
    with pytest.raises(CellError, match="arm runs at 30 % of full speed"):
        require_full_speed("arm", replace(STATE, speed_scaling=0.3))
