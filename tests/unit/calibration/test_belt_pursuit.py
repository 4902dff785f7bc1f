"""Motion relative to an item that rides on a belt: exact arrival, limits, and changes of plan on the way."""

import numpy as np
import pytest

from calibration.belt.pursuit import FixedPoint, Leg, PursuitLimits, PursuitState, plan
from cell.errors import CellError

LIMITS = PursuitLimits(v=1.0, a=6.0, j=80.0)
SPEED = np.array([0.2, -0.05, 0.0, 0.0])
START = PursuitState.still(np.array([0.1, 0.5, 0.3, 0.0]))


class Conveyor:
    """A straight ride with a ripple, known exactly."""

    def __init__(self, p0: np.ndarray, ripple: float = 0.0) -> None:
        self.p0, self.ripple = p0, ripple

    def at(self, t: float) -> PursuitState:
        w = 7.0
        s = t + self.ripple * np.sin(w * t)
        ds, dds = 1.0 + self.ripple * w * np.cos(w * t), -self.ripple * w * w * np.sin(w * t)
        return PursuitState(self.p0 + SPEED * s, SPEED * ds, SPEED * dds)


RIDE = Conveyor(np.array([-0.2, 0.6, 0.15, 0.4]))
ABOVE = np.array([0.0, 0.0, 0.05, 0.0])


def sampled(leg: Leg, step: float = 0.002) -> tuple[np.ndarray, ...]:
    times = np.arange(leg.t0, leg.t1 + 0.2, step)
    states = [leg.at(float(t)) for t in times]
    return times, *(np.array([getattr(s, k) for s in states]) for k in "pva")


def test_the_tool_ends_at_rest_in_the_items_frame_and_stays_there() -> None:
    leg = plan(1.0, START, RIDE, ABOVE, LIMITS)
    for t in (leg.t1, leg.t1 + 0.5):
        off = leg.at(t) - RIDE.at(t)
        assert off.p == pytest.approx(ABOVE, abs=1e-9)
        assert off.v == pytest.approx(0.0, abs=1e-9)


def test_a_leg_begins_in_the_state_it_was_planned_from() -> None:
    moving = PursuitState(START.p, np.array([0.3, -0.1, 0.05, 0.2]), np.array([1.0, 0.0, -0.5, 0.0]))
    found = plan(1.0, moving, RIDE, ABOVE, LIMITS).at(1.0)
    assert found.p == pytest.approx(moving.p, abs=1e-12)
    assert found.v == pytest.approx(moving.v, abs=1e-12)
    assert found.a == pytest.approx(moving.a, abs=1e-12)


def test_speed_in_the_base_and_acceleration_stay_within_the_limits() -> None:
    _, _, v, a = sampled(plan(0.0, START, RIDE, ABOVE, LIMITS))
    assert np.linalg.norm(v[:, :3], axis=1).max() <= LIMITS.v
    assert np.abs(a[:, :3]).max() <= LIMITS.a + 1e-9


def test_velocity_is_the_derivative_of_position_also_on_a_belt_with_ripple() -> None:
    rippling = Conveyor(RIDE.p0, ripple=0.02)
    times, p, v, _ = sampled(plan(0.0, START, rippling, ABOVE, LIMITS), 0.0005)
    differences = (p[2:] - p[:-2]) / (times[2:] - times[:-2])[:, None]
    assert np.abs(differences - v[1:-1]).max() < 2e-4


def test_a_plan_changed_on_the_way_goes_on_without_a_jump() -> None:
    first = plan(0.0, START, RIDE, ABOVE, LIMITS)
    now = 0.5 * first.t1
    moved = Conveyor(RIDE.p0 + np.array([0.004, -0.002, 0.0, 0.0]))
    second = plan(now, first.at(now), moved, ABOVE, LIMITS)
    assert second.at(now).p == pytest.approx(first.at(now).p, abs=1e-12)
    assert second.at(now).v == pytest.approx(first.at(now).v, abs=1e-12)
    assert (second.at(second.t1) - moved.at(second.t1)).p == pytest.approx(ABOVE, abs=1e-9)


def test_a_place_that_stands_is_reached_as_fast_as_the_limits_let() -> None:
    goal = FixedPoint(START.p + np.array([0.1, 0.0, 0.0, 0.0]))
    leg = plan(0.0, START, goal, np.zeros(4), LIMITS)
    # Constant jerk, acceleration and speed phases of a rest-to-rest move (closed form).
    d, v, a, j = 0.1, LIMITS.v, LIMITS.a, LIMITS.j  # the speed is not reached on so short a way
    expected = (
        d / v + v / a + a / j if d >= v * (v / a + a / j) else a / j + np.sqrt((a / j) ** 2 + 4 * d / a)
    )
    assert leg.t1 == pytest.approx(expected, rel=1e-6)


def test_a_state_without_a_common_duration_is_planned_axis_by_axis() -> None:
    state = PursuitState(
        np.array([0.00210966891660487, 0.002319343744510149, 0.002001786699624808, 0.0]),
        np.array([-0.09301268428926319, -0.1246457800190425, -0.08292760196288534, 0.0]),
        np.array([1.284193082562771, 4.465794979961217, 0.8120548444329234, 0.0]),
    )
    leg = plan(0.0, state, FixedPoint(np.zeros(4)), np.zeros(4), LIMITS)
    assert leg.at(leg.t1).p == pytest.approx(0.0, abs=1e-9)


def test_what_is_beside_is_over_before_a_tool_that_comes_down_apart_is_there() -> None:
    beside = PursuitState.still(RIDE.at(0.0).p + np.array([0.03, -0.02, 0.05, 0.1]))
    leg = plan(0.0, beside, RIDE, np.zeros(4), LIMITS, apart=True)
    off = np.array([(leg.at(float(t)) - RIDE.at(float(t))).p for t in np.arange(0.0, leg.t1, 0.001)])
    low = off[:, 2] < 0.005
    assert low.any()
    assert np.abs(off[low, :2]).max() < 1e-4


def test_a_tool_that_has_to_rise_does_so_before_it_has_gone_far() -> None:
    goal = FixedPoint(START.p + np.array([0.4, 0.2, 0.05, 0.0]))
    leg = plan(0.0, START, goal, np.zeros(4), LIMITS)
    half = 0.5 * leg.t1
    assert leg.at(half).p[2] - goal.p[2] == pytest.approx(0.0, abs=1e-6)


def test_against_the_belt_the_tool_has_its_whole_speed_in_the_base() -> None:
    """Seen from the item it then moves faster than the limit, and with the belt slower."""
    fast = Conveyor(np.array([-0.6, 0.5, 0.3, 0.0]))
    _, _, v, _ = sampled(plan(0.0, START, fast, np.zeros(4), LIMITS))
    assert 0.9 * LIMITS.v < np.linalg.norm(v[:, :3], axis=1).max() <= LIMITS.v


def test_a_tool_that_has_to_get_slower_brakes_as_hard_as_ever() -> None:
    goal = FixedPoint(START.p + np.array([0.6, 0.0, 0.0, 0.0]))
    quick = plan(0.0, START, goal, np.zeros(4), LIMITS)
    now = 0.2
    slow = plan(now, quick.at(now), goal, np.zeros(4), LIMITS.slower(0.3))
    fastest = max(float(slow.at(now + 0.001 * k).v[0]) for k in range(400))
    # It still accelerates when told, for as long as the jerk lets it, and not longer.
    a = float(quick.at(now).a[0])
    assert fastest <= float(quick.at(now).v[0]) + a * a / (2.0 * LIMITS.j) + 1e-6
    assert slow.at(now + 0.3).v[0] < 0.31 * LIMITS.v


def test_a_way_that_would_take_hours_is_refused_with_a_code() -> None:
    """Ruckig's answer for it is one that its Python binding cannot name."""
    crawling = PursuitLimits(v=1e-7, a=6.0, j=80.0, yaw_v=1e-7)
    with pytest.raises(CellError, match="no motion within the limits"):
        plan(0.0, START, FixedPoint(np.array([0.6, 0.5, 0.3, 0.3])), ABOVE, crawling)


@pytest.mark.parametrize("size", [0.0, 1e-16, 1e-14, 1e-12, 1e-9])
def test_an_axis_that_has_nothing_to_do_but_for_rounding_stays_where_it_is(size: float) -> None:
    at, up = np.array([0.15, 0.85, 0.35, 0.0]), np.array([0.0, 0.0, 0.05, 0.0])
    rng = np.random.default_rng(1)
    for _ in range(200):
        off, v, a = size * rng.choice([-2.0, -1.0, 0.0, 1.0], (3, 4)) * rng.uniform(0.1, 2.0, (3, 4))
        leg = plan(0.0, PursuitState(at + off, v, a), FixedPoint(at), up, LIMITS)
        way = np.array([leg.at(t).p - at for t in np.linspace(0.0, leg.t1, 9)])
        assert np.abs(way[:, [0, 1, 3]]).max() <= 1e-8, "sideways, while it rises"
        assert way[-1, 2] == pytest.approx(0.05)
