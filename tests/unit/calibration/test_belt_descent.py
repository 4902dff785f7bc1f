"""Down onto an item: as fast as can be, but never onto it while the tool is beside it."""

from collections.abc import Callable

import numpy as np
import pytest

from calibration.belt.descent import BESIDE_M, HOLD_M, TOUCH_M, descend
from calibration.belt.pursuit import Leg, PursuitLimits, PursuitState, plan

LIMITS = PursuitLimits(v=1.0, a=6.0, j=80.0)
FACE = np.zeros(4)
STEP_S = 0.02


class Belt:
    """An item at ``travel(t)`` along x, on a belt whose forecast believes in its speed of now."""

    def __init__(self, travel: Callable[[float], float], now: float) -> None:
        self.x, self.now = travel(now), now
        self.v = (travel(now) - travel(now - 1e-4)) / 1e-4

    def at(self, t: float) -> PursuitState:
        along = np.array([1.0, 0.0, 0.0, 0.0])
        return PursuitState((self.x + self.v * (t - self.now)) * along, self.v * along, 0.0 * along)


def steady(t: float) -> float:
    return 0.2 * t


def stopping(t: float) -> float:
    """From 0.2 m/s to rest at 1 m/s^2, beginning at 0.14 s."""
    s = min(max(t - 0.14, 0.0), 0.2)
    return 0.2 * min(t, 0.34) - 0.5 * s * s


def onto(travel: Callable[[float], float], go: Callable[..., Leg]) -> tuple[float, float]:
    """When the tool touches, s, and how far beside the item it truly is then, m."""
    t, state = (
        0.0,
        PursuitState(np.array([0.02, 0.0, 0.05, 0.0]), np.array([-0.1, 0.0, -0.1, 0.0]), np.zeros(4)),
    )
    state = state + Belt(travel, 0.0).at(0.0)
    while t < 2.0:
        leg = go(t, state, Belt(travel, t), FACE, LIMITS)
        for at in np.arange(t, t + STEP_S, 0.001):
            if (place := leg.at(float(at)).p)[2] <= TOUCH_M:
                return float(at), abs(float(place[0]) - travel(float(at)))
        t += STEP_S
        state = leg.at(t)
    raise AssertionError("the tool never came down")


def straight(t0: float, state: PursuitState, origin: Belt, offset: np.ndarray, limits: PursuitLimits) -> Leg:
    return plan(t0, state, origin, offset, limits, apart=True)


def test_on_a_belt_that_does_as_predicted_less_than_half_a_decision_is_lost() -> None:
    assert onto(steady, descend)[0] == pytest.approx(onto(steady, straight)[0], abs=0.5 * STEP_S)


def test_on_a_belt_that_stops_the_tool_waits_above_the_item_until_it_is_over_it() -> None:
    (early, off), (late, near) = onto(stopping, straight), onto(stopping, descend)
    assert off > 1e-3  # what coming straight down would have meant
    assert near < 2 * BESIDE_M
    assert early < late < early + 0.4


def test_while_it_is_beside_the_tool_comes_to_rest_just_above() -> None:
    beside = PursuitState(np.array([0.003, 0.0, 0.03, 0.0]), np.array([0.15, 0.0, -0.2, 0.0]), np.zeros(4))
    rest = Belt(lambda t: 0.0, 0.0)
    leg = descend(0.0, beside, rest, FACE, LIMITS)
    height = np.array([leg.at(t).p[2] for t in np.arange(0.0, leg.t1, 0.001)])
    assert height.min() >= HOLD_M - 1e-9
    assert leg.gap(leg.t1).p == pytest.approx(0.0, abs=1e-9)


def test_a_cautious_tool_stops_above_the_item_before_it_touches_and_then_goes_on() -> None:
    over = PursuitState(np.array([0.0, 0.0, 0.03, 0.0]), np.array([0.0, 0.0, -0.2, 0.0]), np.zeros(4))
    rest = Belt(lambda t: 0.0, 0.0)
    assert descend(0.0, over, rest, FACE, LIMITS).offset == pytest.approx(FACE)
    leg = descend(0.0, over, rest, FACE, LIMITS, cautious=True)
    assert leg.at(leg.t1).p[2] == pytest.approx(HOLD_M)
    on = descend(leg.t1, leg.at(leg.t1), rest, FACE, LIMITS, cautious=True)
    assert on.offset == pytest.approx(FACE)


def test_a_tool_too_low_to_stop_above_goes_on() -> None:
    low = PursuitState(np.array([0.005, 0.0, 0.002, 0.0]), np.array([0.0, 0.0, -0.2, 0.0]), np.zeros(4))
    leg = descend(0.0, low, Belt(lambda t: 0.0, 0.0), FACE, LIMITS)
    assert leg.offset == pytest.approx(FACE)
