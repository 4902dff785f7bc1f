"""The TCP in plain floats, against the chain's own matrices and Jacobian and against SciPy."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cell.poses import Array, from_pose6
from fakes.ur.tcp import TcpKinematics
from fakes.world.arm.kinematics import Chain, LinkDeltas, chain


def arm(rng: np.random.Generator, scale: float) -> Chain:
    return chain("ur10e", LinkDeltas(*(tuple(rng.normal(0.0, scale, 6).tolist()) for _ in range(4))))


@pytest.mark.parametrize("scale", [0.0, 1e-9, 1e-3])
def test_pose_and_velocity_are_those_of_the_chain(scale: float) -> None:
    rng = np.random.default_rng(3)
    links = arm(rng, scale)
    subject = TcpKinematics(links)
    for _ in range(20):
        q, qd, tool = rng.uniform(-3.0, 3.0, 6), rng.normal(size=6), rng.normal(0.0, 0.3, 6)
        pose, velocity = subject.at(q.tolist(), qd.tolist(), tuple(tool.tolist()))
        expected = links.forward(q) * from_pose6(tool)
        np.testing.assert_allclose(pose[:3], expected.translation, atol=1e-12)
        turn = Rotation.from_rotvec(pose[3:]).inv() * expected.rotation
        assert turn.magnitude() < 1e-12
        np.testing.assert_allclose(velocity, links.jacobian(q, tool[:3]) @ qd, atol=1e-12)


def test_velocity_is_the_change_of_the_pose() -> None:
    rng = np.random.default_rng(4)
    subject = TcpKinematics(arm(rng, 1e-3))
    q, qd, tool, dt = rng.uniform(-1.5, 1.5, 6), rng.normal(size=6), (0.1, 0.0, 0.2, 0.0, 0.3, 0.0), 1e-6

    def position(q: Array) -> Array:
        return np.array(subject.at(q.tolist(), qd.tolist(), tool)[0][:3])

    change = (position(q + qd * dt) - position(q - qd * dt)) / (2.0 * dt)
    np.testing.assert_allclose(subject.at(q.tolist(), qd.tolist(), tool)[1][:3], change, atol=1e-8)


def test_another_tool_or_other_speeds_at_the_same_joints_are_answered_anew() -> None:
    subject = TcpKinematics(chain("ur5e"))
    q, still = [0.1, -1.0, 1.0, 0.2, 0.3, 0.4], [0.0] * 6
    flange, at_rest = subject.at(q, still, (0.0,) * 6)
    tip, _ = subject.at(q, still, (0.0, 0.0, 0.1, 0.0, 0.0, 0.0))
    _, moving = subject.at(q, [0.1] * 6, (0.0,) * 6)
    assert np.linalg.norm(np.subtract(tip[:3], flange[:3])) == pytest.approx(0.1)
    assert at_rest == still
    assert any(moving)
