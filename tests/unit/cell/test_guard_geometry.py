"""Distances that decide about collisions, against brute-force sampling."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cell.guard.geometry import segment_box_distance, segment_segment_distance, segments_in_union
from cell.poses import Array

# Coarse steps make the degenerate cases common: parallel, touching, zero length, on a face.
coordinate = st.integers(-4, 4).map(lambda k: 0.25 * k)
point = st.tuples(coordinate, coordinate, coordinate).map(np.array)
smooth_point = st.tuples(*[st.floats(-1, 1)] * 3).map(np.array)
STEPS = 2000


def _along(p0: Array, p1: Array) -> Array:
    return p0 + np.linspace(0, 1, STEPS + 1)[:, None] * (p1 - p0)


@settings(max_examples=300, deadline=None)
@given(st.one_of(point, smooth_point), st.one_of(point, smooth_point), point, point)
def test_the_distance_to_a_box_is_the_smallest_over_all_points(
    p0: Array, p1: Array, a: Array, b: Array
) -> None:
    low, high = np.minimum(a, b), np.maximum(a, b) + 0.1
    points = _along(p0, p1)
    brute = np.min(np.linalg.norm(points - np.clip(points, low, high), axis=1))
    exact = segment_box_distance(p0[None], p1[None], low, high)[0]
    assert exact <= brute + 1e-12
    assert exact >= brute - np.linalg.norm(p1 - p0) / (2 * STEPS) - 1e-12


@settings(max_examples=300, deadline=None)
@given(*[st.one_of(point, smooth_point)] * 4)
def test_the_distance_of_two_segments_is_the_smallest_over_all_points(
    p0: Array, p1: Array, q0: Array, q1: Array
) -> None:
    points = _along(p0, p1)
    along = q1 - q0
    length2 = along @ along
    t = np.clip((points - q0) @ along / length2, 0, 1) if length2 > 0 else np.zeros(len(points))
    brute = np.min(np.linalg.norm(points - q0 - t[:, None] * along, axis=1))
    exact = segment_segment_distance(p0[None], p1[None], q0[None], q1[None])[0]
    assert exact >= brute - np.linalg.norm(p1 - p0) / (2 * STEPS) - 1e-6
    assert exact <= brute + 1e-6


@settings(max_examples=150, deadline=None)
@given(smooth_point, smooth_point, st.lists(st.tuples(smooth_point, smooth_point), min_size=1, max_size=4))
def test_a_segment_is_in_a_union_of_boxes_when_all_its_points_are(
    p0: Array, p1: Array, corners: list[tuple[Array, Array]]
) -> None:
    low = np.array([np.minimum(a, b) - 0.3 for a, b in corners])
    high = np.array([np.maximum(a, b) + 0.3 for a, b in corners])

    def all_points_inside(grown: float) -> bool:
        points = _along(p0, p1)[:, None]
        inside = ((points >= low - grown) & (points <= high + grown)).all(axis=2).any(axis=1)
        return bool(inside.all())

    # Between samples a gap of less than a step can hide, so brute force decides only away from the faces.
    step = float(np.linalg.norm(p1 - p0)) / STEPS
    found = bool(segments_in_union(p0[None], p1[None], low, high)[0])
    if found:
        assert all_points_inside(1e-9)
    if all_points_inside(-2 * step - 1e-9):
        assert found


def test_a_segment_through_two_touching_boxes_is_inside_and_through_a_gap_is_not() -> None:
    low = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    high = np.array([[1.0, 1.0, 1.0], [2.0, 1.0, 1.0]])
    p0, p1 = np.array([[0.2, 0.5, 0.5]]), np.array([[1.8, 0.6, 0.5]])
    assert segments_in_union(p0, p1, low, high)[0]
    low[1, 0] = 1.001
    assert not segments_in_union(p0, p1, low, high)[0]


@pytest.mark.parametrize(
    ("p0", "p1", "expected"),
    [
        ([2, 0.5, 0.5], [3, 0.5, 0.5], 1.0),  # off a face
        ([2, 2, 0.5], [2, 2, 0.6], 2**0.5),  # off an edge
        ([2, 2, 2], [2, 2, 2], 3**0.5),  # a point off a corner
        ([-1, 0.5, 0.5], [2, 0.5, 0.5], 0.0),  # through
        ([0.4, 0.5, 0.5], [0.6, 0.5, 0.5], 0.0),  # wholly inside
        ([2, 0, 0.5], [0, 2, 0.5], 0.0),  # touching an edge
    ],
)
def test_known_distances_to_the_unit_box(p0: list[float], p1: list[float], expected: float) -> None:
    found = segment_box_distance(np.array([p0], float), np.array([p1], float), np.zeros(3), np.ones(3))
    np.testing.assert_allclose(found, [expected], atol=1e-12)
