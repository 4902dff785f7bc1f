"""From the tool's motion to joints: against the arm's own forward kinematics."""

from collections.abc import Sequence
from typing import cast

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from calibration.belt.pursuit import FixedPoint, PursuitLimits, PursuitState, plan
from calibration.kinematics import robot_from_spec
from cell.errors import CellError
from cell.guard import MotionGuard
from cell.poses import Array
from procedures.belt.config import BeltTrackingConfig
from procedures.belt.motion.blend import BESIDE_M, blend_for
from procedures.belt.motion.tool_joints import ToolJoints, fastest_on_piece, on_piece
from procedures.belt.motion.tool_path import STEP_S, ToolPath
from tests.kit.motion_bench import OpenGuard

MODEL = robot_from_spec({"model": "ur10e"})
T_FLANGE_TOOL = RigidTransform.from_components([0.02, -0.01, 0.18], Rotation.from_rotvec([0.0, 0.0, 0.2]))
WAIT = np.array([-2.067451, -1.757146, 2.164129, -1.977778, -1.570796, -0.496655])
LIMITS = PursuitLimits(v=1.0, a=6.0, j=80.0)
CONFIG = {"wait_pose": "w", "place_pose": "p", "zone": {"min_m": 0.0, "max_m": 1.0}, "belt_z_m": 0.1}


@pytest.fixture
def subject() -> ToolJoints:
    return ToolJoints(MODEL, T_FLANGE_TOOL, WAIT)


def moved(subject: ToolJoints, *by: float) -> PursuitState:
    return PursuitState(subject.state(WAIT).p + np.array(by), np.array([0.3, -0.2, 0.1, 0.5]), np.zeros(4))


def test_joints_put_the_tool_where_it_should_be(subject: ToolJoints) -> None:
    state = moved(subject, 0.02, -0.03, 0.05, 0.4)
    q, _ = subject.joints(state, WAIT)
    tool = MODEL.forward(q) * T_FLANGE_TOOL
    assert tool.translation == pytest.approx(state.p[:3], abs=1e-9)
    upright = (MODEL.forward(WAIT) * T_FLANGE_TOOL).rotation
    turn = (tool.rotation * upright.inv()).as_rotvec()
    assert turn == pytest.approx([0.0, 0.0, 0.4], abs=1e-9)


def test_the_point_of_many_joints_is_that_of_each(subject: ToolJoints) -> None:
    Q = WAIT + np.random.default_rng(2).uniform(-0.5, 0.5, (4, 6))
    assert subject.points(Q) == pytest.approx(np.array([subject.state(q).p[:3] for q in Q]), abs=1e-12)


def test_joint_speeds_are_the_derivative_of_the_joints(subject: ToolJoints) -> None:
    state, h = moved(subject, 0.02, -0.03, 0.05, 0.4), 1e-5
    q, qd = subject.joints(state, WAIT)
    after, _ = subject.joints(PursuitState(state.p + h * state.v, state.v, state.a), q)
    before, _ = subject.joints(PursuitState(state.p - h * state.v, state.v, state.a), q)
    assert qd == pytest.approx((after - before) / (2 * h), abs=1e-6)


def test_a_line_of_states_gives_what_each_alone_gives(subject: ToolJoints) -> None:
    goal = subject.state(WAIT).p + np.array([0.2, 0.3, -0.01, 0.5])
    leg = plan(0.0, subject.state(WAIT), FixedPoint(goal), np.zeros(4), LIMITS)
    states = [leg.at(float(t)) for t in np.linspace(0.0, leg.t1, 9)]
    Q, Qd = subject.line(states, WAIT)
    near = WAIT
    for state, q, qd in zip(states, Q, Qd, strict=True):
        near, speed = subject.joints(state, near)
        assert q == pytest.approx(near, abs=1e-8)
        assert qd == pytest.approx(speed, abs=1e-7)
    assert np.all(subject.fastest(leg, WAIT) >= np.abs(Qd).max(axis=0) - 0.05)


def test_a_place_out_of_reach_is_told_with_its_coordinates(subject: ToolJoints) -> None:
    with pytest.raises(CellError, match=r"2\.120") as caught:
        subject.joints(moved(subject, 2.0, 0.0, 0.0, 0.0), WAIT)
    assert caught.value.name == "MOTION_UNREACHABLE"


def test_a_piece_is_what_it_was_made_of_and_stands_at_its_end(subject: ToolJoints) -> None:
    states = [(WAIT + 0.01 * k, np.full(6, 0.2)) for k in range(3)]
    piece = subject.piece(5.0, 0.05, states)
    for k, (q, qd) in enumerate(states):
        found = on_piece(piece, 5.0 + 0.05 * k)
        assert found[0] == pytest.approx(q, abs=1e-9)
        assert found[1] == pytest.approx(qd, abs=1e-7)
    assert on_piece(piece, 6.0)[0] == pytest.approx(states[-1][0], abs=1e-9)


def test_a_tool_that_goes_round_the_corner_is_beside_the_item_before_the_straight_part() -> None:
    config = BeltTrackingConfig.model_validate(CONFIG)
    round_it = blend_for(config, LIMITS)
    start, goal = PursuitState.still(np.array([0.4, 0.3, 0.05, 0.0])), FixedPoint(np.zeros(4))
    level = plan(0.0, start, goal, np.array([0.0, 0.0, 0.05, 0.0]), LIMITS)
    turn = level.t1 - round_it.lead_s
    down = plan(turn, level.at(turn), goal, np.zeros(4), LIMITS, apart=True)
    for t in np.arange(turn, down.t1, 0.002):
        p = down.at(float(t)).p
        if p[2] < 0.02:
            assert np.linalg.norm(p[:2]) < 1.5 * BESIDE_M
    square = plan(level.t1, level.at(level.t1), goal, np.zeros(4), LIMITS)
    assert down.t1 < square.t1 - 0.15


def test_the_sources_moves_begin_and_end_at_rest_unless_told_otherwise() -> None:
    classic = BeltTrackingConfig.model_validate({**CONFIG, "method": "classic"})
    assert blend_for(classic, LIMITS).lead_s == 0.0
    assert blend_for(classic, LIMITS).clear_m == classic.above_m
    told = BeltTrackingConfig.model_validate({**CONFIG, "method": "classic", "straight_m": 0.02})
    assert blend_for(told, LIMITS).lead_s > 0.1


def test_a_piece_is_looked_for_where_the_piece_before_goes(
    subject: ToolJoints, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = BeltTrackingConfig.model_validate(CONFIG)
    path = ToolPath(subject, config.limits, cast(MotionGuard, OpenGuard()), subject.state(WAIT))
    path.start(0.0, WAIT, FixedPoint(subject.state(WAIT).p))
    path.go(0.0, FixedPoint(subject.state(WAIT).p + np.array([0.2, 0.3, -0.05, 0.5])), np.zeros(4))
    off: list[float] = []
    line = subject.line

    def watched(states: Sequence[PursuitState], near: Array) -> tuple[Array, Array]:
        Q, Qd = line(states, near)
        off.append(float(np.abs(Q - near).max()))
        return Q, Qd

    monkeypatch.setattr(subject, "line", watched)
    here = WAIT, np.zeros(6)
    for t in np.arange(0.0, 0.2, 0.02).tolist():
        here = on_piece(path.piece(t, here), t + 0.02)
    assert off[0] > 0.01  # from rest nothing is known yet
    assert max(off[1:]) < 0.005


@pytest.mark.parametrize("rad_s", [0.8, 0.5])
def test_a_way_whose_goal_leaps_keeps_the_joints_within_their_limits(
    rad_s: float, subject: ToolJoints
) -> None:
    """On the way out the plan for the way back is too fast for a joint, sooner than a slower plan helps."""
    limits = BeltTrackingConfig.model_validate({**CONFIG, "limits": {"joint_speed_rad_s": rad_s}}).limits
    path = ToolPath(subject, limits, cast(MotionGuard, OpenGuard()), subject.state(WAIT))
    start, way = subject.state(WAIT).p, np.array([0.5, 0.5, 0.02, 0.3])
    here, t, fastest, apart, ahead = (WAIT, np.zeros(6)), 1.0, list[float](), list[float](), list[float]()
    path.start(t, WAIT, FixedPoint(start + way))
    for step in range(900):  # the slowest joints take 17 s past the arm's base
        path.catch_up(t, here)
        apart.append(float(np.linalg.norm(path.at(t).p - subject.moving(*here).p)))
        if step == 25:
            path.go(t, FixedPoint(start - way), np.zeros(4))
            path.at_full_speed()
        piece = path.piece(t, here)
        fastest.append(float(fastest_on_piece(piece).max()))
        ahead.append(piece.t1 - piece.t0)
        t += STEP_S
        here = on_piece(piece, t)
    assert max(fastest) <= rad_s
    assert max(ahead) > 0.151  # more time was needed somewhere
    assert max(apart) < 5e-4  # plan and arm are at one place whenever something is decided
    assert subject.state(here[0]).p == pytest.approx(start - way, abs=1e-3)


class Runaway:
    """What is believed of an item for a moment: it goes off, faster and faster."""

    def __init__(self, begun: float, p: Array, m_s2: float) -> None:
        self._begun, self._p, self._m_s2 = begun, p, m_s2

    def at(self, t: float) -> PursuitState:
        s, way = t - self._begun, np.array([0.6, 0.8, 0.0, 0.0])
        a = self._m_s2 * way
        return PursuitState(self._p + (0.2 * s * way + 0.5 * a * s * s), 0.2 * way + a * s, a)


@pytest.mark.parametrize(("m_s2", "limit_m_s"), [(3.0, 1.0), (6.0, 1.0), (6.0, 0.4)])
def test_a_tool_that_goes_with_something_too_fast_keeps_its_own_speed_limit(
    m_s2: float, limit_m_s: float, subject: ToolJoints
) -> None:
    limits = BeltTrackingConfig.model_validate({**CONFIG, "limits": {"speed_m_s": limit_m_s}}).limits
    path = ToolPath(subject, limits, cast(MotionGuard, OpenGuard()), subject.state(WAIT))
    here, t, fastest = (WAIT, np.zeros(6)), 1.0, list[float]()
    path.start(t, WAIT, FixedPoint(subject.state(WAIT).p))
    item = Runaway(t, subject.state(WAIT).p, m_s2)
    for _ in range(20):
        path.catch_up(t, here)
        path.go(t, item, np.zeros(4))
        piece = path.piece(t, here)
        Q, Qd = zip(*(on_piece(piece, float(at)) for at in np.linspace(piece.t0, piece.t1, 20)), strict=True)
        fastest.append(float(subject.speeds(np.array(Q), np.array(Qd)).max()))
        t += STEP_S
        here = on_piece(piece, t)
    assert 0.5 * limit_m_s < max(fastest) <= limit_m_s


def test_the_speed_of_the_tools_point_is_that_of_its_motion(subject: ToolJoints) -> None:
    state = moved(subject, 0.02, -0.03, 0.05, 0.4)
    q, qd = subject.joints(state, WAIT)
    expected = np.linalg.norm(state.v[:3])
    assert subject.speeds(q[None], qd[None]) == pytest.approx([expected], abs=1e-9)


def test_the_tools_motion_is_that_of_the_joints(subject: ToolJoints) -> None:
    state = moved(subject, 0.02, -0.03, 0.05, 0.4)
    found = subject.moving(*subject.joints(state, WAIT))
    assert found.p == pytest.approx(state.p, abs=1e-9)
    assert found.v == pytest.approx(state.v, abs=1e-9)
