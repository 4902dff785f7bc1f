"""What the motion guard lets through and what it refuses, and in which words."""

import time
from contextlib import suppress
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from calibration.kinematics import UrArmModel
from cell.arm_model import Capsule
from cell.errors import CellError
from cell.guard import PLANNED_CLEAR_M, GuardLimits, MotionGuard, Tool
from cell.motion import Guard
from cell.poses import Array, from_pose6

ALL = 1_000_000  # samples of a path in one stride: each of them is looked at
HOME = np.array([0.0, -1.8, 1.8, -1.57, -1.57, 0.0])
PILLAR = {"name": "pillar", "min": [0.6, -0.2, 0.0], "max": [0.8, 0.2, 1.5]}
HALL = {"min": [-1.3, -1.3, 0.0], "max": [1.3, 1.3, 1.8]}
ARM = UrArmModel("ur10e")
HOME_POSE = ARM.forward(HOME)


class RecordingArm(UrArmModel):
    """Keeps the joint vectors (n, 6) that were looked at."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.seen: list[Array] = []

    def link_ends(self, Q: Array) -> Array:
        self.seen.append(Q)
        return super().link_ends(Q)


def make_guard(**changes: Any) -> MotionGuard:
    table: dict[str, Any] = {
        "speed_m_s": 0.25,
        "accel_m_s2": 0.5,
        "joint_speed_rad_s": 0.8,
        "allow_job_override": False,
        "workspace": [HALL],
        "keep_out": [PILLAR],
    }
    tool = Tool.from_mapping({"name": "gripper", "T_flange_tool": [0, 0, 0.18, 0, 0, 0], "radius_m": 0.03})
    tool = changes.pop("tool", tool)
    arm = changes.pop("arm", ARM)
    return MotionGuard(arm, GuardLimits.from_mapping(table | changes), tool)


@pytest.fixture
def subject() -> MotionGuard:
    return make_guard()


def refusal(call: Any, *args: Any, **kwargs: Any) -> CellError:
    with pytest.raises(CellError) as caught:
        call(*args, **kwargs)
    return caught.value


def turned(*angles: float) -> Array:
    """The home joints plus these angles."""
    return HOME + np.array(angles)


def shifted(x: float, y: float, z: float) -> RigidTransform:
    """The home pose moved in the base frame."""
    return RigidTransform.from_translation([x, y, z]) * HOME_POSE


def test_it_is_the_guard_that_a_motion_lease_wants(subject: MotionGuard) -> None:
    guard: Guard = subject
    guard.check_path_joints(HOME, HOME + 0.1)


def test_a_pose_in_the_open_passes(subject: MotionGuard) -> None:
    subject.check_joints(HOME)
    assert subject.describe(HOME).ok


def test_a_joint_beyond_its_range_is_refused_by_name(subject: MotionGuard) -> None:
    failure = refusal(subject.check_joints, turned(0, 0, 2.0, 0, 0, 0))
    assert failure.name == "MOTION_LIMIT"
    assert "'elbow' would be at 3.800 rad" in str(failure)
    assert "range -3.142 to 3.142 rad" in str(failure)


@pytest.mark.parametrize("q", [HOME[:5], HOME * np.nan])
def test_joints_that_are_no_joints_are_refused(subject: MotionGuard, q: Array) -> None:
    assert refusal(subject.check_joints, q).name == "MOTION_LIMIT"


def test_a_path_through_a_box_is_refused_although_both_ends_are_free(subject: MotionGuard) -> None:
    start, end = turned(np.pi - 0.9, 0, 0, 0, 0, 0), turned(np.pi + 0.9, 0, 0, 0, 0, 0)
    subject.check_joints(start)
    subject.check_joints(end)
    failure = refusal(subject.check_path_joints, start, end)
    assert failure.name == "MOTION_COLLISION"
    assert "keep-out box 'pillar'" in str(failure)
    assert "mm beyond the limit at" in str(failure)


def test_a_path_past_a_box_is_free_when_the_box_is_gone() -> None:
    subject = make_guard(keep_out=[])
    subject.check_path_joints(turned(np.pi - 0.9, 0, 0, 0, 0, 0), turned(np.pi + 0.9, 0, 0, 0, 0, 0))


def test_no_capsule_point_moves_farther_than_the_sampling_step_between_samples(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("cell.guard.guard._STRIDE", ALL)
    arm = RecordingArm("ur10e")
    subject = make_guard(arm=arm)
    rng = np.random.default_rng(2)
    for _ in range(20):
        arm.seen.clear()
        with suppress(CellError):
            subject.check_path_joints(rng.uniform(-3, 3, 6), rng.uniform(-3, 3, 6))
        (Q,) = arm.seen
        tips = (ARM.forward_many(Q) * subject.tool.T_flange_tool).translation
        points = [tips, *np.moveaxis(ARM.link_ends(Q).reshape(len(Q), -1, 3), 1, 0)]
        assert max(np.max(np.linalg.norm(np.diff(p, axis=0), axis=1)) for p in points) <= 0.0101


ROOMS = {
    "hall": {},
    "boxes that overlap": {
        "workspace": [
            {"min": [-1.3, -1.3, 0.0], "max": [0.1, 1.3, 1.8]},
            {"min": [0.0, -1.3, 0.0], "max": [1.3, 1.3, 1.2]},
            {"min": [-0.5, -1.3, 0.3], "max": [0.9, 0.4, 1.9]},
        ]
    },
    "open": {"workspace": [{"min": [-2, -2, -1], "max": [2, 2, 2.5]}], "keep_out": []},
}


@pytest.mark.parametrize("room", ROOMS)
def test_a_path_is_judged_as_if_each_of_its_samples_were_looked_at(
    room: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    subject, rng = make_guard(**ROOMS[room]), np.random.default_rng(11)
    paths = []
    for k in range(60):
        start = HOME + 0.3 * rng.normal(size=6)
        way = 0.8 * rng.normal(size=6) + [rng.uniform(-2.0, 2.0), 0, 0, 0, 0, 0]
        paths.append((start, np.clip(start + way, -3.1, 3.1), (0.0, PLANNED_CLEAR_M)[k % 2]))

    def judged() -> list[str | None]:
        found: list[str | None] = []
        for start, end, clear_m in paths:
            try:
                subject.check_path_joints(start, end, clear_m)
                found.append(None)
            except CellError as failure:
                found.append(str(failure))
        return found

    here_and_there = judged()
    monkeypatch.setattr("cell.guard.guard._STRIDE", ALL)
    assert here_and_there == judged()
    assert 5 < here_and_there.count(None) < 55, "some are free, and some are not"


def test_most_of_a_path_in_the_open_is_not_looked_at() -> None:
    arm = RecordingArm("ur10e")
    subject = make_guard(arm=arm, keep_out=[])
    start, end = turned(-1.0, 0, 0, 0, 0, 0), turned(1.0, 0, 0, 0, 0, 0)
    subject.check_path_joints(start, end)
    assert sum(len(Q) for Q in arm.seen) < len(subject._joint_samples(start, end)) / 3


def test_a_link_hits_a_box_that_the_tool_misses() -> None:
    # A beam just above the upper arm's elbow at home.
    elbow = ARM.capsules(HOME)[3].p0
    beam = {"name": "beam", "min": [*(elbow[:2] - 0.05), elbow[2] + 0.05], "max": [*(elbow[:2] + 0.05), 2.0]}
    failure = refusal(make_guard(keep_out=[beam]).check_joints, HOME)
    assert failure.name == "MOTION_COLLISION"
    assert "keep-out box 'beam'" in str(failure)
    assert "upper arm" in str(failure) or "elbow" in str(failure)


def test_the_base_may_stand_in_a_box_but_the_arm_may_not_dip_into_it() -> None:
    table = {"name": "table", "min": [-1.5, -1.5, -0.5], "max": [1.5, 1.5, 0.0]}
    subject = make_guard(keep_out=[table], workspace=[{"min": [-2, -2, -2], "max": [2, 2, 2]}])
    subject.check_joints(HOME)
    failure = refusal(subject.check_joints, turned(0, 0.9, 0, 0, 0, 0))
    assert failure.name == "MOTION_COLLISION"
    assert "'table'" in str(failure)


def test_links_stay_above_the_floor_of_the_workspace() -> None:
    subject = make_guard(keep_out=[])
    # The tool is high up while the elbow dips below the base plate.
    failure = refusal(subject.check_joints, np.array([0.0, 0.35, -2.2, -1.5, -1.57, 0.0]))
    assert failure.name == "MOTION_COLLISION"
    assert "the floor" in str(failure)


def test_a_workspace_that_starts_above_the_base_plate_is_no_floor_for_the_links() -> None:
    high = {"min": [-1.3, -1.3, 0.3], "max": [1.3, 1.3, 1.8]}
    make_guard(workspace=[high]).check_joints(HOME)


def test_the_tool_outside_the_workspace_is_refused() -> None:
    near = {"min": [-0.5, -1.3, 0.0], "max": [1.3, 1.3, 1.8]}
    failure = refusal(make_guard(workspace=[near]).check_joints, HOME)
    assert failure.name == "MOTION_COLLISION"
    assert "'gripper' and the workspace" in str(failure) or "'wrist 3' and the workspace" in str(failure)


def test_the_tool_may_stand_in_two_overlapping_workspace_boxes_at_once() -> None:
    tip = (HOME_POSE * from_pose6([0, 0, 0.18, 0, 0, 0])).translation
    upper = {"min": [-1.3, -1.3, tip[2] + 0.08], "max": [1.3, 1.3, 1.8]}
    lower = {"min": [-1.3, -1.3, 0.0], "max": [1.3, 1.3, tip[2] + 0.16]}
    both = make_guard(workspace=[upper, lower], tool=Tool(from_pose6([0, 0, 0.18, 0, 0, 0]), 0.03))
    both.check_joints(HOME)
    assert refusal(make_guard(workspace=[upper]).check_joints, HOME).name == "MOTION_COLLISION"
    assert refusal(make_guard(workspace=[lower]).check_joints, HOME).name == "MOTION_COLLISION"


def test_a_tcp_may_touch_the_workspace_face() -> None:
    tip = (HOME_POSE * from_pose6([0, 0, 0.18, 0, 0, 0])).translation
    floor = {"min": [-1.3, -1.3, tip[2] - 0.002], "max": [1.3, 1.3, 1.8]}
    make_guard(workspace=[floor]).check_joints(HOME)
    above = {"min": [-1.3, -1.3, tip[2] + 0.002], "max": [1.3, 1.3, 1.8]}
    assert "gripper" in str(refusal(make_guard(workspace=[above]).check_joints, HOME))


def test_a_planned_way_keeps_clear_of_a_box_that_a_path_may_touch() -> None:
    tip = (HOME_POSE * from_pose6([0, 0, 0.18, 0, 0, 0])).translation
    rib = {"name": "rib", "min": [*(tip[:2] - 0.05), 0.0], "max": [*(tip[:2] + 0.05), tip[2] - 0.003]}
    subject = make_guard(keep_out=[rib])
    start, end = turned(-0.5, 0, 0, 0, 0, 0), turned(0.5, 0, 0, 0, 0, 0)
    subject.check_path_joints(start, end)
    failure = refusal(subject.check_path_joints, start, end, PLANNED_CLEAR_M)
    assert failure.name == "MOTION_COLLISION"
    assert "keep-out box 'rib'" in str(failure)
    assert "10.0 mm are kept so that an arm stopped there can leave" in str(failure)


def test_a_planned_way_may_leave_a_place_that_is_nearer_than_a_plan_would_go() -> None:
    tip = (HOME_POSE * from_pose6([0, 0, 0.18, 0, 0, 0])).translation
    subject = make_guard(workspace=[{"min": [-1.3, -1.3, tip[2] - 0.002], "max": [1.3, 1.3, 1.8]}])
    up = ARM.inverse(shifted(0, 0, 0.05), HOME)
    assert up is not None
    subject.check_path_joints(HOME, up, PLANNED_CLEAR_M)
    assert subject.free(np.array([HOME, up])).tolist() == [True, True]
    assert subject.free(np.array([HOME, up]), PLANNED_CLEAR_M).tolist() == [False, True]


def test_an_arm_may_stand_beyond_a_face_to_measuring_accuracy_and_no_further() -> None:
    tip = (HOME_POSE * from_pose6([0, 0, 0.18, 0, 0, 0])).translation
    near, beyond = (
        make_guard(workspace=[{"min": [-1.3, -1.3, tip[2] + off], "max": [1.3, 1.3, 1.8]}])
        for off in (0.0002, 0.002)
    )
    near.check_standing(HOME)
    assert "where the arm stands" in str(refusal(beyond.check_standing, HOME))


def test_a_path_may_leave_the_face_that_the_arm_stands_on_to_measuring_accuracy() -> None:
    tip = (HOME_POSE * from_pose6([0, 0, 0.18, 0, 0, 0])).translation
    subject = make_guard(workspace=[{"min": [-1.3, -1.3, tip[2] + 0.0002], "max": [1.3, 1.3, 1.8]}])
    up = ARM.inverse(shifted(0, 0, 0.05), HOME)
    assert up is not None
    refusal(subject.check_joints, HOME)
    subject.check_path_joints(HOME, up)
    refusal(subject.check_path_joints, up, HOME)
    lower = make_guard(workspace=[{"min": [-1.3, -1.3, tip[2] + 0.002], "max": [1.3, 1.3, 1.8]}])
    refusal(lower.check_path_joints, HOME, up)


def test_an_attachment_on_the_flange_counts_as_part_of_the_tool() -> None:
    arm_of_camera = Capsule(np.zeros(3), np.array([0.0, -0.5, 0.05]), 0.04, "camera")
    tool = Tool(from_pose6([0, 0, 0.18, 0, 0, 0]), 0.03, attachments=(arm_of_camera,))
    reach = HOME_POSE.apply(np.array([0.0, -0.5, 0.05]))
    box = {"name": "rack", "min": (reach - 0.05).tolist(), "max": (reach + 0.05).tolist()}
    failure = refusal(make_guard(keep_out=[box], tool=tool).check_joints, HOME)
    assert "'camera' and keep-out box 'rack'" in str(failure)


def test_the_tool_may_not_run_into_the_arm_itself() -> None:
    folded = np.array([0.0, -1.8, 2.9, 1.2, -1.57, 0.0])
    tool = Tool(from_pose6([0, 0, 0.35, 0, 0, 0]), 0.05, "long gripper")
    failure = refusal(make_guard(keep_out=[], tool=tool).check_joints, folded)
    assert failure.name == "MOTION_COLLISION"
    assert "the arm's own" in str(failure)


def test_a_straight_line_in_the_open_passes(subject: MotionGuard) -> None:
    subject.check_path_linear(HOME_POSE, shifted(0.05, 0.2, 0.1), HOME)


def test_a_line_through_a_box_is_refused_although_both_ends_are_free() -> None:
    box = {"name": "post", "min": [-0.75, -0.02, 0.0], "max": [-0.6, 0.02, 1.5]}
    subject = make_guard(keep_out=[box])
    start, end = shifted(0, -0.25, 0), shifted(0, 0.6, 0)
    q0 = ARM.inverse(start, HOME)
    assert q0 is not None
    subject.check_joints(q0)
    failure = refusal(subject.check_path_linear, start, end, q0)
    assert failure.name == "MOTION_COLLISION"
    assert "'post'" in str(failure)


def test_a_line_out_of_reach_says_where_it_ends(subject: MotionGuard) -> None:
    failure = refusal(subject.check_path_linear, HOME_POSE, shifted(-0.9, 0, 0), HOME)
    assert failure.name == "MOTION_UNREACHABLE"
    assert "% of the line" in str(failure)


def test_a_line_past_the_shoulder_axis_is_refused_for_joint_speed() -> None:
    # Along x, passing the base axis at a distance near the wrist's offset: joint 1 has to spin.
    subject = make_guard(keep_out=[])
    start = from_pose6([-0.45, -0.25, 0.75, 0.0, np.pi, 0.0])
    end = from_pose6([0.45, -0.25, 0.75, 0.0, np.pi, 0.0])
    q0 = min(ARM.inverse_all(start), key=lambda q: float(np.abs(q - HOME).sum()))
    failure = refusal(subject.check_path_linear, start, end, q0)
    assert failure.name in ("MOTION_LIMIT", "MOTION_UNREACHABLE")


def test_a_line_too_fast_for_a_joint_passes_at_a_lower_speed(subject: MotionGuard) -> None:
    end = shifted(0.05, 0.4, 0.0)
    fast = make_guard(speed_m_s=1.0)
    failure = refusal(fast.check_path_linear, HOME_POSE, end, HOME)
    assert failure.name == "MOTION_LIMIT"
    assert "m/s" in str(failure)
    fast.check_path_linear(HOME_POSE, end, HOME, speed_m_s=0.1)


def test_a_line_too_short_to_get_up_to_speed_is_not_refused_for_joint_speed() -> None:
    """Where the arm is said to be has noise: some 0.01 mm and 0.1 mrad, more than this line is long."""
    rng = np.random.default_rng(0)
    q0 = np.array([-1.020579, -1.626522, 2.055822, -2.000097, -1.570796, 0.550218])
    goal = ARM.forward(q0)
    subject = make_guard(joint_speed_rad_s=0.8, speed_m_s=0.25, keep_out=[])
    for _ in range(300):
        noise = from_pose6([*rng.normal(0.0, 1e-5, 3), *rng.normal(0.0, 1e-4, 3)])
        subject.check_path_linear(goal * noise, goal, q0)


def test_the_tcp_and_not_the_flange_travels_on_the_line() -> None:
    arm = RecordingArm("ur10e")
    subject = make_guard(arm=arm)
    tool = subject.tool.T_flange_tool
    turn = RigidTransform.from_rotation(Rotation.from_rotvec([0.5, 0, 0]))
    subject.check_path_linear(HOME_POSE, HOME_POSE * tool * turn * tool.inv(), HOME)
    flanges = ARM.forward_many(arm.seen[-1])
    assert np.max(np.ptp(flanges.translation, axis=0)) > 0.05
    # Between the poses of the line the samples are straight in the joints, which bends it a little.
    assert np.max(np.ptp((flanges * tool).translation, axis=0)) < 2e-4


def test_an_arm_model_that_is_not_this_arm_is_noticed(subject: MotionGuard) -> None:
    failure = refusal(subject.check_path_linear, shifted(0, 0.05, 0), shifted(0, 0.1, 0), HOME)
    assert failure.name == "MOTION_LIMIT"
    assert "50.0 mm" in str(failure)


def test_a_set_point_within_the_speeds_passes(subject: MotionGuard) -> None:
    subject.check_setpoints(HOME[None], np.full((1, 6), 0.05))


def test_a_set_point_that_turns_a_joint_too_fast_is_refused(subject: MotionGuard) -> None:
    failure = refusal(
        subject.check_setpoints, np.array([HOME] * 2), np.array([[0.0] * 6, [0, 0, 0, 0, 0, 0.81]])
    )
    assert "'wrist 3' at 0.810 rad/s" in str(failure)


def test_a_set_point_that_moves_the_tcp_too_fast_is_refused(subject: MotionGuard) -> None:
    failure = refusal(subject.check_setpoints, HOME[None], np.array([[0.5, 0, 0, 0, 0, 0]]))
    assert failure.name == "MOTION_LIMIT"
    radius = float(np.linalg.norm((HOME_POSE * subject.tool.T_flange_tool).translation[:2]))
    assert f"{0.5 * radius:.3f} m/s" in str(failure)


def test_margins_name_the_nearest_box_and_shrink_towards_it(subject: MotionGuard) -> None:
    far, near = subject.describe(HOME), subject.describe(turned(2.0, 0, 0, 0, 0, 0))
    assert "pillar" in far.clearance
    assert far.clearance_m is not None
    assert near.clearance_m is not None
    assert near.clearance_m < far.clearance_m
    broken = subject.describe(turned(np.pi, 0, 0, 0, 0, 0))
    assert not broken.ok
    assert broken.as_dict()["clearance_m"] < 0


def test_margins_agree_with_the_check(subject: MotionGuard) -> None:
    for q in np.random.default_rng(5).uniform(-2.5, 2.5, (200, 6)):
        if subject.describe(q).ok:
            subject.check_joints(q)
        else:
            refusal(subject.check_joints, q)


def test_margins_without_boxes_have_no_clearance() -> None:
    assert make_guard(keep_out=[]).describe(HOME).clearance_m is None


def test_a_box_with_min_above_max_is_a_config_error() -> None:
    failure = refusal(make_guard, keep_out=[{"name": "odd", "min": [0, 0, 1], "max": [1, 1, 0]}])
    assert failure.name == "CONFIG_INVALID"
    assert "'odd'" in str(failure)


def test_an_empty_workspace_is_a_config_error() -> None:
    assert refusal(make_guard, workspace=[]).name == "CONFIG_INVALID"


def test_a_typical_joint_path_is_checked_in_a_few_milliseconds(subject: MotionGuard) -> None:
    best = np.inf
    for _ in range(5):
        started = time.perf_counter()
        subject.check_path_joints(HOME, turned(0.8, 0.2, -0.3, 0.3, 0.4, 0.8))
        best = min(best, time.perf_counter() - started)
    assert best < 0.1, "20 ms by design; five times that on a busy machine"


def test_each_joint_is_held_to_its_own_speed() -> None:
    each = [2.0, 2.0, 2.0, 0.3, 2.0, 2.0]
    subject, Q = make_guard(joint_speed_rad_s=each, speed_m_s=5.0, keep_out=[]), HOME[None]
    subject.check_setpoints(Q, np.array([[1.0, 0.0, 0.0, 0.2, 0.0, 0.0]]))
    failure = refusal(subject.check_setpoints, Q, np.array([[1.0, 0.0, 0.0, 0.4, 0.0, 0.0]]))
    assert "joint 'wrist 1' at 0.400 rad/s, limit 0.3 rad/s" in str(failure)


def test_a_line_is_held_to_the_speed_of_each_joint() -> None:
    end = shifted(0.0, 0.2, 0.0)
    make_guard(joint_speed_rad_s=2.0, keep_out=[]).check_path_linear(HOME_POSE, end, HOME)
    slow = make_guard(joint_speed_rad_s=[0.1, *[2.0] * 5], keep_out=[])
    failure = refusal(slow.check_path_linear, HOME_POSE, end, HOME)
    assert "joint 'base' would turn at" in str(failure)
    assert "(limit 0.1 rad/s)" in str(failure)


def test_a_slow_joint_lets_no_other_turn_faster_on_a_line() -> None:
    """The tool turns on the spot near a singular pose of the wrist; no joint paces that."""
    start = HOME.copy()
    start[4] = -0.2
    tool = make_guard().tool.T_flange_tool
    turn = RigidTransform.from_rotation(Rotation.from_rotvec([0.4, 0.0, 0.0]))
    T0 = ARM.forward(start)
    for speeds in (2.0, [0.2, *[2.0] * 5]):
        subject = make_guard(joint_speed_rad_s=speeds, speed_m_s=0.5, keep_out=[])
        failure = refusal(subject.check_path_linear, T0, T0 * tool * turn * tool.inv(), start)
        assert "would turn at" in str(failure), speeds
