"""A person of the twin who brings the tool's point over a point of the board."""

import asyncio
from pathlib import Path

import numpy as np
import pytest

from cell.errors import CellError
from fakes.twin.serve import Twin, TwinOptions
from fakes.world.scenario import Scenario
from fakes.world.targets import target_points
from fakes.world.world import World


def test_the_tools_point_is_brought_over_the_printed_corner_of_an_imperfect_cell() -> None:
    subject = World.from_scenario(Scenario.load("workshop"))
    for point in (0, 53):
        t = subject.bring_over(subject.track.end_time, point, 0.003, 0.0)
        assert not subject.track.is_moving(t)
        above = subject.T_mount_target[0].inv().apply(subject.tool_point(t))
        true = subject.printed.placed(target_points(subject.target)[[point]])[0]
        assert np.linalg.norm(above - true - [0.0, 0.0, -0.003]) < 0.0002, "but for how the arm repeats"
    there = subject.tool_point(t)
    t = subject.bring_over(t, 53, 0.003, 0.001)
    assert 0.0002 < np.linalg.norm(subject.tool_point(t) - there) < 0.005, "beside it, as hands are"
    with pytest.raises(CellError, match="with a point 54"):
        subject.bring_over(t, 54, 0.003, 0.0)


def test_the_twins_operator_is_asked_for_it(tmp_path: Path) -> None:
    subject = Twin(TwinOptions("hand_eye", tmp_path))
    request = {"do": "operator", "over": 8, "gauge_m": 0.003, "hand_m": 0.0}
    takes_s = asyncio.run(subject._handle(request))
    now = subject.controller.now()
    assert 0.0 < subject.world.track.end_time - now <= takes_s
