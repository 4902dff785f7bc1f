"""Beam and tool axis as lines in space, judged by other means."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from calibration.tool_frame import geometry as geo
from calibration.tool_frame.scene import Line, ReferenceTool, Refused

small = st.floats(-0.3, 0.3)
R = Rotation.from_euler("xyz", [170.0, 8.0, 40.0], degrees=True).as_matrix()
TOOL = ReferenceTool.of([0.01, -0.02, 0.18], [0.05, 0.1, 1.0], 0.003)
BEAMS = {"xs": Line.of([0.5, 0.1, 0.2], [1.0, 0.1, 0.02]), "ys": Line.of([0.4, 0.0, 0.21], [-0.2, 1.0, 0.0])}


@settings(max_examples=25, deadline=None)
@given(small, small, small)
def test_the_signed_distance_is_the_least_distance_of_the_two_lines(x: float, y: float, z: float) -> None:
    frame = geo.frames(BEAMS, R, TOOL)["xs"]
    tip, axis = np.array([x, y, z]), R @ TOOL.axis

    def squared(k: np.ndarray) -> float:
        gap = tip + k[0] * axis - frame.line.point - k[1] * frame.line.direction
        return float(gap @ gap)

    least = np.sqrt(minimize(squared, [0.0, 0.0], tol=1e-14).fun)
    assert abs(float(frame.across(tip[None])[0])) == pytest.approx(least, abs=1e-5)


@settings(max_examples=25, deadline=None)
@given(small, small)
def test_the_axis_comes_back_from_what_both_beams_see_of_it(a: float, b: float) -> None:
    beams, axis = geo.frames(BEAMS, R, TOOL), R @ TOOL.axis
    across = np.cross(axis, [0.3, 1.0, 0.2])
    turned = Rotation.from_rotvec(a * np.cross(across, axis) + b * across).apply(axis)
    seen = {name: geo.seen_turn(frame, turned) for name, frame in beams.items()}
    assert geo.turned_axis(beams, axis, seen) == pytest.approx(turned, abs=1e-12)
    turn = geo.smallest_turn(axis, turned)
    assert geo.rotated(axis, turn) == pytest.approx(turned, abs=1e-12)
    assert abs(turn @ axis) < 1e-12


def test_a_displacement_is_put_together_from_both_beams_and_the_height() -> None:
    beams, axis = geo.frames(BEAMS, R, TOOL), R @ TOOL.axis
    moved = np.array([0.001, -0.002, 0.0005])
    shift = {name: float(frame.n @ moved) for name, frame in beams.items()}
    assert geo.in_base(beams, axis, shift, float(-axis @ moved)) == pytest.approx(moved, abs=1e-15)


def test_parallel_beams_and_a_beam_along_the_tool_are_refused() -> None:
    with pytest.raises(Refused, match="beams-parallel"):
        geo.frames({**BEAMS, "ys": Line.of([0, 0, 0], [1.0, 0.05, 0.0])}, R, TOOL)
    with pytest.raises(Refused, match="beam-along-tool"):
        geo.frames({**BEAMS, "ys": Line.of([0, 0, 0], R @ TOOL.axis)}, R, TOOL)
