"""What it costs to keep the rule of thumb, where joints have limits of their own."""

import numpy as np
import pytest

from procedures.tracker.rule_of_thumb import rule_cost


def test_each_way_takes_as_long_as_the_joint_that_needs_longest() -> None:
    path = np.array([np.zeros(6), [1.0, 0, 0, 0, 0, 0], [1.0, 0, 0, 0, 0, 1.0], [1.5, 0, 0, 0, 0, 2.0]])
    one = {"joint_speed_rad_s": 1.0, "joint_accel_rad_s2": 10.0}
    each = one | {"joint_speed_rad_s": [0.25, 1.0, 1.0, 1.0, 1.0, 1.0]}
    assert rule_cost(path, path, one)["moving_s"] == pytest.approx(3 * 1.1)
    # 1 rad at 0.25 rad/s; 1 rad at 1 rad/s; 1 rad at 0.5 rad/s, as the base turns half as far meanwhile
    expected = 4.025 + 1.1 + 2.05
    assert rule_cost(path, path, each)["moving_s"] == pytest.approx(expected)
    assert rule_cost(path, path, each)["travel_rad"] == pytest.approx(3.0)
