"""Light beams in the twin and the tool: two fingers, bends, obstacles."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cell.poses import to_pose6
from fakes.world.scenario import Scenario
from fakes.world.world import World
from tests.kit.beam_scene import OVER, Q0, TOOL, assert_crossings, beam, shift, world


def test_a_gripper_with_two_fingers_makes_four_edges_on_each_way() -> None:
    fingers = [{"from": [0.0, y, -0.003], "to": [0.0, y, -0.05], "radius_m": 0.003} for y in (-0.012, 0.012)]
    subject = world(shape=fingers, xs=beam([0.0, 0.03, 0.01], [1, 0, 0]))
    v = 0.05
    end = shift(subject, 0.0, [0.0, 0.06, 0.0], v, 2.0)
    edges = subject.beams.edges("xs", 0.0, end)
    assert [level for _, level in edges] == [True, False, True, False]
    assert edges[2][0] - edges[0][0] == pytest.approx(0.024 / v, abs=5e-6)
    assert_crossings(subject, "xs", edges)
    assert subject.beams.count("xs", end) == 2


def test_a_bend_moves_the_tools_point_and_turns_it_in_the_flange() -> None:
    subject = world()
    subject.tool.bend(5.0, [1.2e-3, -0.7e-3, 0.5e-3], [0.01, -0.005, 0.0])
    assert np.allclose(to_pose6(subject.T_flange_tool_at(4.999)), to_pose6(TOOL))
    bent = subject.T_flange_tool_at(5.0)
    assert bent.translation == pytest.approx([1.2e-3, -0.7e-3, 0.1805])
    axis = Rotation.from_rotvec([0.01, -0.005, 0.0]).apply([0.0, 0.0, 1.0])
    assert bent.rotation.apply([0.0, 0.0, 1.0]) == pytest.approx(axis)
    subject.tool.straighten(6.0)
    assert np.allclose(to_pose6(subject.T_flange_tool_at(6.0)), to_pose6(TOOL))
    truth = subject.truth(5.5)
    assert truth["T_flange_tool"] == pytest.approx(to_pose6(bent).tolist())
    assert truth["T_flange_tool_nominal"] == pytest.approx([0, 0, 0.18, 0, 0, 0])


def test_a_bend_at_rest_can_break_a_beam_at_that_very_time() -> None:
    subject = world(xs=beam([0.0, 0.0055, 0.01], [1, 0, 0]))
    assert not subject.beams.level("xs", 20.0)
    # Flange y points against base y.
    subject.tool.bend(10.0, [0.0, -0.004, 0.0])
    subject.tool.straighten(12.0)
    assert subject.beams.edges("xs", 0.0, 20.0) == [(10.0, True), (12.0, False)]


def test_a_bent_tool_crosses_where_it_truly_is() -> None:
    subject = world(xs=beam([0.0, 0.02, 0.01], [1, 0, 0]))
    v = 0.05
    subject.tool.bend(0.0, [0.0, -0.001, 0.0], [0.02, 0.0, 0.0])
    shift(subject, 0.0, [0.0, 0.04, 0.0], v, 2.0)
    edges = subject.beams.edges("xs", 0.0, 5.0)
    assert_crossings(subject, "xs", edges)
    straight = world(xs=beam([0.0, 0.02, 0.01], [1, 0, 0]))
    shift(straight, 0.0, [0.0, 0.04, 0.0], v, 2.0)
    (a, _), (b, _) = straight.beams.edges("xs", 0.0, 5.0)
    sooner = 0.5 * (a + b) - 0.5 * (edges[0][0] + edges[1][0])
    # One millimetre further on, and the axis 10 mm up is back by the tilt: the turn about flange x by
    # +0.02 takes the pin's upper end to flange +y, base -y.
    assert sooner * v == pytest.approx(0.001 - 0.010 * 0.02, abs=2e-6)


def test_an_obstacle_feels_the_true_tool() -> None:
    wall = {
        "point": (OVER.translation + np.array([0.0, 0.0, 0.001])).tolist(),
        "normal": [0, 0, 1],
        "stiffness_n_m": 1e4,
    }
    raw = {"arm": {"model": "ur10e", "q_start": Q0.tolist()}, "obstacle": [wall]}
    subject = World.from_scenario(Scenario.model_validate({"schema": "cellward.scenario/1", "world": raw}))
    subject.tool.bend(1.0, [0.002, 0.0, 0.001])  # along flange z: down
    assert subject.contact_force(0.0, TOOL) == pytest.approx([0, 0, 10.0, 0, 0, 0], abs=1e-6)
    # The tip is 2 mm beside the TCP in flange x, which is base x.
    assert subject.contact_force(1.0, TOOL) == pytest.approx([0, 0, 20.0, 0, -0.04, 0], abs=1e-6)
