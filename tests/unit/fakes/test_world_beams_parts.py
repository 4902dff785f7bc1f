"""What the twin's light beams are computed from: distances, and joints at many times."""

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.spatial.transform import RigidTransform

from fakes.world.arm.distance import to_segments
from fakes.world.arm.profile import Trapezoid
from fakes.world.arm.segments import Hold, JointMove, JointSpeed, JointStop, Polynomial, Segment
from fakes.world.arm.sweep import fastest, joints, states
from fakes.world.arm.track import Track
from tests.kit.beam_scene import ARM, Q0, TOOL, segments_apart


def test_the_distance_is_the_least_over_all_pairs_of_points() -> None:
    rng = np.random.default_rng(2)
    for _ in range(40):
        axis, middle = rng.uniform(-1, 1, (2, 3)), rng.uniform(-1, 1, 3)
        way, half = rng.normal(size=3), rng.uniform(0.05, 1.0)
        way /= np.linalg.norm(way)

        def squared(x: np.ndarray) -> float:
            gap = axis[0] + x[0] * (axis[1] - axis[0]) - middle - x[1] * half * way  # noqa: B023
            return float(gap @ gap)

        least = minimize(squared, [0.5, 0.0], bounds=[(0, 1), (-1, 1)], tol=1e-15)
        found = to_segments(axis[None, None], middle[None], way[None], np.array([half]))
        assert found.shape == (1, 1, 1)
        assert found[0, 0, 0] == pytest.approx(np.sqrt(least.fun), abs=1e-6)
        assert found[0, 0, 0] <= np.sqrt(least.fun) + 1e-12
        c, d = middle - half * way, middle + half * way
        assert found[0, 0, 0] == pytest.approx(segments_apart(axis[:1], axis[1:], c, d)[0], abs=1e-12)


def test_points_and_parallel_axes_have_a_distance_too() -> None:
    x = np.array([[1.0, 0.0, 0.0]])
    middle, half = np.zeros((1, 3)), np.array([0.5])
    for axis, least in (
        ([[0.0, 0.3, 0.0], [0.0, 0.3, 0.0]], 0.3),
        ([[-0.2, 0.0, 0.4], [0.2, 0.0, 0.4]], 0.4),
        ([[0.9, 0.3, 0.0], [2.0, 0.3, 0.0]], 0.5),
    ):
        assert to_segments(np.array([[axis]]), middle, x, half)[0, 0, 0] == pytest.approx(least, abs=1e-12)


def segments() -> list[Segment]:
    rng = np.random.default_rng(4)
    q1, qd = Q0 + rng.uniform(-0.5, 0.5, 6), rng.uniform(-1, 1, 6)
    lines = Track(0.0, Q0)
    goal = RigidTransform.from_translation([0.05, 0.1, -0.05]) * ARM.forward(Q0) * TOOL
    lines.start_linear_move(1.0, ARM, goal, TOOL, 0.25, 1.0)
    whole = lines.segment_at(1.1)
    lines.stop_linear(1.3, 2.0)
    return [
        Hold(1.0, Q0),
        JointMove(1.0, Q0, q1, Trapezoid(float(np.max(np.abs(q1 - Q0))), 0.7, 2.0)),
        JointMove(1.0, Q0, Q0, Trapezoid(0.0, 0.7, 2.0)),
        JointStop(1.0, Q0, qd, 3.0),
        JointSpeed(1.0, Q0, qd, -0.5 * qd, 4.0),
        Polynomial(1.0, 1.4, 0.9, np.array([Q0, 0.3 * qd, -qd, 2.0 * qd])),
        whole,
        lines.segment_at(1.31),
    ]


@pytest.mark.parametrize("kind", range(8))
def test_many_times_at_once_are_the_same_joints_and_no_joint_is_faster_than_said(kind: int) -> None:
    segment = segments()[kind]
    end = min(segment.t_end, segment.t0 + 3.0) + 0.1
    times = np.linspace(segment.t0, end, 501)
    single = [segment.at(float(t)) for t in times]
    assert np.allclose(joints(segment, times), [q for q, _ in single], rtol=0.0, atol=1e-12)
    speeds = np.max(np.abs([qd for _, qd in single]), axis=0)
    limit = fastest(segment)
    assert np.all(speeds <= limit + 1e-12)
    if isinstance(segment, Polynomial):
        assert np.allclose(
            joints(segment, inside := times[times <= segment.t1]),
            [segment.at(t)[0] for t in inside],
            atol=1e-12,
        )
    if not isinstance(segment, Polynomial):  # whose bound is a sum
        assert np.all(limit <= 1.3 * speeds + 1e-2)


@pytest.mark.parametrize("kind", range(8))
@pytest.mark.parametrize("count", [1, 2, 16])
def test_states_at_many_times_are_those_of_single_ones_bit_by_bit(kind: int, count: int) -> None:
    segment = segments()[kind]
    end = min(segment.t_end, segment.t0 + 3.0) + 0.1
    times = np.linspace(segment.t0, end, 160).tolist()
    single = [np.stack(segment.at(t)) for t in times]
    found = [states(segment, times[k : k + count]) for k in range(0, len(times), count)]
    assert np.array_equal(np.concatenate([np.stack(each, axis=1) for each in found]), single)


def test_no_point_of_the_tool_is_faster_than_levers_and_joint_speeds_allow() -> None:
    rng = np.random.default_rng(6)
    levers = ARM.levers()
    for _ in range(200):
        q, qd, point = rng.uniform(-3, 3, 6), rng.uniform(-1, 1, 6), rng.uniform(-0.2, 0.2, 3)
        speed = np.linalg.norm((ARM.jacobian(q, point) @ qd)[:3])
        assert speed <= np.abs(qd) @ (levers + np.linalg.norm(point)) + 1e-12
    assert np.all(np.diff(levers) < 0)
    assert levers[0] < 1.8
