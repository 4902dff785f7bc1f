"""Figures that a person reads: an axis that one count cannot set, and an error beyond its 95 % bound."""

from pathlib import Path

import numpy as np
import pytest

from cell.formats.result import read_as
from procedures.belt.report.live import speed_axis
from procedures.laser.result import LaserResult
from procedures.laser.truth import judge_tool
from tests.kit.whole_results import whole


def test_the_axis_of_the_belts_speed_follows_what_was_believed() -> None:
    low, high = speed_axis(np.array([np.nan, 0.10, 0.12]))
    assert low < 0.0 < 0.12 < high < 0.2


def test_a_belt_that_runs_backwards_or_stands_has_an_axis_too() -> None:
    low, high = speed_axis(np.array([-0.3, -0.2]))
    assert low < -0.3
    assert high > 0.0
    assert speed_axis(np.array([])) == [-0.01, 0.01]


@pytest.mark.parametrize(("tilt", "told"), [(0.0025, False), (0.0030, True)])
def test_an_error_between_the_bounds_is_said_to_be_as_one_of_twenty_is(tilt: float, told: bool) -> None:
    result = {
        "result": {"T_flange_tool": [0.0, 0.0, 0.18, tilt, 0.0, 0.0]},
        "uncertainty": {"U_point_m": 0.00003, "U_tilt_rad": 0.00257},
        "inputs": {"update": {"committed": True}},
    }
    measured = read_as(LaserResult, whole({"kind": "laser", "verdict": "pass", **result}))
    found = judge_tool(measured, {"T_flange_tool": [0.0, 0.0, 0.18, 0.0, 0.0, 0.0]}, Path())
    assert found.good
    assert ("beyond the 95 % bound, as 1 of 20 is" in found.text) is told
