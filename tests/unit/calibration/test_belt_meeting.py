"""The arm's time against ruckig, and the earliest contact against a plain search."""

import numpy as np
import pytest
import ruckig
from hypothesis import given, settings
from hypothesis import strategies as st

from calibration.belt.arm_time import MotionLimits, rest_to_rest, slower_axis
from calibration.belt.meeting import Zone, meeting_time

LIMITS = MotionLimits(1.0, 6.0, 80.0)
EVERYWHERE = Zone(None, None)


def ruckig_time(distance: float, limits: MotionLimits) -> float:
    otg, start, course = ruckig.Ruckig(1), ruckig.InputParameter(1), ruckig.Trajectory(1)
    start.target_position = [distance]
    start.max_velocity, start.max_acceleration, start.max_jerk = [limits.v], [limits.a], [limits.j]
    otg.calculate(start, course)
    return float(course.duration)


@settings(max_examples=150, deadline=None)
@given(
    distance=st.floats(-3.0, 3.0),
    v=st.floats(0.05, 3.0),
    a=st.floats(0.2, 20.0),
    j=st.floats(2.0, 400.0),
)
def test_the_closed_form_equals_ruckig(distance: float, v: float, a: float, j: float) -> None:
    limits = MotionLimits(v, a, j)
    found = float(rest_to_rest(np.array(distance), limits))
    assert found == pytest.approx(ruckig_time(distance, limits), rel=1e-6, abs=2e-4 * (abs(distance) < 1e-6))


def test_the_slower_axis_counts() -> None:
    found = slower_axis(np.array([[0.5, -0.1], [0.1, 0.2]]), np.array([0.0, 0.0]), LIMITS)
    assert found == pytest.approx([ruckig_time(0.5, LIMITS), ruckig_time(0.2, LIMITS)], rel=1e-6)


def meet(
    x0: float, v: float, zone: Zone = EVERYWHERE, dwell: float = 0.0, limits: MotionLimits = LIMITS
) -> float | None:
    """Contact with an item at ``x0 + v t`` asked at 0, the arm at the origin, 50 ms of descent."""
    return meeting_time(
        0.0, lambda t: rest_to_rest(x0 + v * t, limits) + 0.05, lambda t: x0 + v * t, zone, dwell
    )


@pytest.mark.parametrize(("x0", "v"), [(-0.4, 0.2), (0.1, 0.3), (0.3, 0.0), (0.2, -0.25)])
def test_the_earliest_contact_is_the_first_root(x0: float, v: float) -> None:
    t = meet(x0, v)
    assert t is not None
    fine = np.arange(0.0, 3.0, 1e-5)
    lag = np.array([ruckig_time(float(x), LIMITS) for x in x0 + v * fine[::2000]])
    first = fine[::2000][np.flatnonzero(lag + 0.05 <= fine[::2000])[0]]
    assert first - 0.02 <= t <= first
    assert ruckig_time(x0 + v * t, LIMITS) + 0.05 == pytest.approx(t, abs=1e-6)


def test_an_item_above_the_zone_is_waited_for_at_its_edge() -> None:
    assert meet(-0.8, 0.2, Zone(-0.1, 0.3)) == pytest.approx(3.5, abs=1e-6)


def test_an_item_that_leaves_the_zone_during_the_dwell_is_out_of_reach() -> None:
    free = meet(0.1, 0.3)
    assert free is not None
    edge = 0.1 + 0.3 * free
    assert meet(0.1, 0.3, Zone(-1.0, edge + 0.3 * 0.06), dwell=0.05) == pytest.approx(free)
    assert meet(0.1, 0.3, Zone(-1.0, edge + 0.3 * 0.04), dwell=0.05) is None


def test_a_belt_that_runs_backward_is_held_to_the_other_edge() -> None:
    free = meet(0.2, -0.25)
    assert free is not None
    edge = 0.2 - 0.25 * free
    assert meet(0.2, -0.25, Zone(edge - 0.25 * 0.06, 1.0), dwell=0.05) == pytest.approx(free)
    assert meet(0.2, -0.25, Zone(edge - 0.25 * 0.04, 1.0), dwell=0.05) is None


def test_a_belt_faster_than_the_arm_is_not_caught() -> None:
    assert meet(0.3, 0.5, limits=MotionLimits(0.4, 6.0, 80.0)) is None


def test_an_item_that_stands_outside_of_the_zone_is_out_of_reach() -> None:
    assert meet(-0.5, 0.0, Zone(-0.1, 0.3)) is None
