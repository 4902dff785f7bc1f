"""An arm seen and moved through another model than its controller believes: states, poses, silences."""

import asyncio
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from calibration.kinematics import measured_arm, robot_from_spec
from cell.devices import ArmState, Speed, ToolSettings, flange_poses
from cell.errors import CellError, error
from cell.modelled_arm import ArmModels, ModelledArm
from cell.poses import exp_xi, from_pose6, log_xi, to_pose6
from cell.samples import Sample, Stream

BELIEVED = robot_from_spec({"model": "ur10e"})
OWN = measured_arm(
    {"model": "ur10e"},
    {
        "model": "ur10e",
        "calibration": {
            "delta_theta": [0.0, 0.0017, -0.0019, 0.0014, -0.0016, 0.0],
            "delta_a": [0.0003, 0.0010, -0.0008, 0.0, 0.0, 0.0],
        },
    },
)
MODELS = ArmModels(OWN, BELIEVED)
Q = np.array([0.2, -1.5, 1.7, -1.9, -1.4, 0.3])
TCP = from_pose6([0.0, 0.0, 0.18, 0.0, 0.0, 0.3])
SPEED = Speed(0.1, 0.5, 0.5, 1.0)
TOOL = ToolSettings(TCP, 1.0)


def state_at(q: np.ndarray) -> ArmState:
    """As the controller reports it."""
    zeros = np.zeros(6)
    pose6 = to_pose6(BELIEVED.forward(q) * TCP)
    return ArmState(q, zeros, pose6, zeros, to_pose6(TCP), 7, 1, False, 0, 0, 0.0)


class HandClock:
    t = 0.0

    def now(self) -> float:
        return self.t

    async def sleep(self, seconds: float) -> None:
        self.t += seconds


class Controller:
    """Arm and port in one: keeps what it is told. ``silent``: no sample comes any more."""

    name = "arm"
    motion_begun = False

    def __init__(self, q: np.ndarray) -> None:
        self.clock = HandClock()
        self.state: Stream[ArmState] = Stream("arm.state", self.clock)
        self.q, self.silent = q, False
        self.told: list[Any] = []
        self.report()

    def report(self) -> None:
        seq = self.state.received
        self.state.push(Sample(state_at(self.q), self.clock.now(), 0.001, seq))

    async def wait_fresh(self, timeout: float) -> None:
        if self.silent:
            raise error("DEVICE_LOST", "arm")
        self.report()

    async def open_motion(self, tool: ToolSettings) -> "Controller":
        self.told.append(tool)
        return self

    async def move_linear(self, T_base_flange: RigidTransform, speed: Speed) -> None:
        self.told.append(T_base_flange)

    async def guarded_move(self, T_base_flange: RigidTransform, speed: Speed, *limits: float) -> bool:
        self.told.append(T_base_flange)
        return True

    async def move_joints(self, q: np.ndarray, speed: Speed) -> None:
        self.told.append(q)


@pytest.fixture
def controller() -> Controller:
    return Controller(Q)


@pytest.fixture
def subject(controller: Controller) -> ModelledArm:
    return ModelledArm(controller, MODELS)  # type: ignore[arg-type]


def test_flange_poses_are_those_of_the_own_model(subject: ModelledArm, controller: Controller) -> None:
    state = subject.state.latest(0.1).value
    np.testing.assert_allclose(to_pose6(state.T_base_flange), to_pose6(OWN.forward(Q)), atol=1e-12)
    np.testing.assert_allclose(
        to_pose6(flange_poses([state, state])[1]), to_pose6(OWN.forward(Q)), atol=1e-12
    )
    raw = controller.state.latest(0.1).value
    np.testing.assert_allclose(to_pose6(raw.T_base_flange), to_pose6(BELIEVED.forward(Q)), atol=1e-9)
    assert np.linalg.norm(state.T_base_flange.translation - raw.T_base_flange.translation) > 1e-3
    np.testing.assert_array_equal(state.tcp_pose6, raw.tcp_pose6)


def test_all_but_the_model_is_as_the_controller_reports_it(
    subject: ModelledArm, controller: Controller
) -> None:
    told = replace(state_at(Q), digital_in=5, digital_out=3, stamp=7.0, speed_scaling=0.5)
    controller.state.push(Sample(told, controller.clock.now(), 0.001, controller.state.received))
    seen = subject.state.latest(1.0).value
    names = {field.name for field in fields(ArmState)}
    assert {name for name in names if getattr(seen, name) is not getattr(told, name)} == {"model"}


def test_a_line_is_told_as_the_controller_takes_it_and_joints_go_as_they_are(
    subject: ModelledArm, controller: Controller
) -> None:
    wanted = OWN.forward(Q) * exp_xi([0.05, -0.04, 0.06, 0.1, 0.0, 0.2])

    async def main() -> None:
        port = await subject.open_motion(TOOL)
        await port.move_linear(wanted, SPEED)
        assert await port.guarded_move(wanted, SPEED, 10.0, 0.1)
        await port.move_joints(Q + 0.1, SPEED)

    asyncio.run(main())
    tool, line, guarded, joints = controller.told
    assert tool is TOOL
    for told in (line, guarded):
        q = BELIEVED.inverse(told, Q)  # where a controller goes that believes its model
        assert q is not None
        np.testing.assert_allclose(log_xi(wanted.inv() * OWN.forward(q)), np.zeros(6), atol=1e-8)
    assert np.linalg.norm(line.translation - wanted.translation) > 1e-3
    np.testing.assert_array_equal(joints, Q + 0.1)


def test_a_long_line_is_followed_on_its_branch() -> None:
    end = Q + np.array([1.5, 0.4, -0.6, 0.5, -1.2, 2.9])
    start, goal = OWN.forward(Q), OWN.forward(end)
    way, q = log_xi(start.inv() * goal), Q
    for share in np.linspace(0.0, 1.0, 400)[1:]:
        found = OWN.inverse(start * exp_xi(share * way), q)
        assert found is not None
        q = found
    nearest = OWN.inverse(goal, Q)
    assert nearest is not None
    assert np.linalg.norm(nearest - Q) < np.linalg.norm(q - Q) - 0.1, "the nearest joints are another branch"
    np.testing.assert_allclose(to_pose6(MODELS.told(goal, Q)), to_pose6(BELIEVED.forward(q)), atol=1e-8)


def test_a_short_silence_is_waited_out_and_a_long_one_moves_nothing(
    subject: ModelledArm, controller: Controller
) -> None:
    wanted = OWN.forward(Q) * exp_xi([0.02, 0.0, 0.0, 0.0, 0.0, 0.0])

    async def main() -> None:
        port = await subject.open_motion(TOOL)
        controller.clock.t = 0.15
        await port.move_linear(wanted, SPEED)
        controller.clock.t, controller.silent = 0.4, True
        with pytest.raises(CellError) as caught:
            await port.move_linear(wanted, SPEED)
        assert caught.value.name == "DEVICE_LOST"

    asyncio.run(main())
    assert len(controller.told) == 2


def test_a_controller_that_reports_other_poses_than_it_should_is_not_moved(controller: Controller) -> None:
    other = robot_from_spec({"model": "ur10e", "calibration": {"delta_a": [0.0, 0.0005, 0.0, 0.0, 0.0, 0.0]}})
    subject = ModelledArm(controller, ArmModels(OWN, other))  # type: ignore[arg-type]
    with pytest.raises(CellError, match=r"reports the flange 0\.50 mm and 0\.00 mrad from") as caught:
        asyncio.run(subject.open_motion(TOOL))
    assert caught.value.name == "KINEMATICS_OTHER_ARM"
    assert controller.told == []


def test_what_a_pose_was_seen_with_does_not_hide_what_the_controller_reports() -> None:
    seen = replace(state_at(Q), model=OWN)
    MODELS.check_belief(seen)
