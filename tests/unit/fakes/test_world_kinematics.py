"""The twin's kinematics against UR's published model in an independent library."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform

from cell.poses import exp_xi, from_pose6
from fakes.world.arm.kinematics import MODELS, Chain, LinkDeltas, UnreachableError, chain, displacement
from tests.kit.ur_reference import independent_poses, models_of_the_library

JOINTS = st.lists(st.floats(-3.1, 3.1), min_size=6, max_size=6)
Q = np.array([0.1, -1.2, 1.3, -1.0, -1.5, 0.3])


@pytest.fixture(scope="module")
def subject() -> Chain:
    return chain("ur10e")


@pytest.mark.parametrize("model", sorted(set(MODELS) & set(models_of_the_library())))
def test_forward_kinematics_equal_an_independent_library(model: str) -> None:
    q, reference = independent_poses(model)
    assert np.max(np.abs(chain(model).matrix(q) - reference)) < 1e-12


def test_one_pose_and_many_poses_agree(subject: Chain) -> None:
    q = np.random.default_rng(1).uniform(-2, 2, (5, 6))
    assert np.array_equal(subject.matrix(q)[3], subject.matrix(q[3]))
    assert np.allclose(subject.forward(q).as_matrix(), subject.matrix(q), atol=1e-12)


def test_calibration_deltas_act_as_in_denavit_and_hartenberg_links() -> None:
    deltas = LinkDeltas(
        delta_theta=(1e-3, -2e-3, 3e-3, 1e-3, 5e-4, 1e-4),
        delta_d=(1e-3, 300.0, -300.002, 1e-4, -2e-4, 3e-4),
        delta_a=(2e-4, 1e-3, -5e-4, 1e-4, 2e-4, 0.0),
        delta_alpha=(1e-3, 2e-4, -3e-4, 1e-3, -1e-3, 0.0),
    )
    d = np.array([0.1807, 0, 0, 0.17415, 0.11985, 0.11655]) + deltas.delta_d
    a = np.array([0, -0.6127, -0.57155, 0, 0, 0]) + deltas.delta_a
    alpha = np.array([np.pi / 2, 0, 0, np.pi / 2, -np.pi / 2, 0]) + deltas.delta_alpha
    expected = np.eye(4)
    for i in range(6):
        c, s = np.cos(Q[i] + deltas.delta_theta[i]), np.sin(Q[i] + deltas.delta_theta[i])
        ca, sa = np.cos(alpha[i]), np.sin(alpha[i])
        expected = expected @ np.array(
            [[c, -s * ca, s * sa, a[i] * c], [s, c * ca, -c * sa, a[i] * s], [0, sa, ca, d[i]], [0, 0, 0, 1]]
        )
    assert np.max(np.abs(chain("ur10e", deltas).matrix(Q) - expected)) < 1e-10


def test_deltas_add_up_and_reject_a_wrong_length() -> None:
    both = LinkDeltas(delta_a=(1, 0, 0, 0, 0, 0)) + LinkDeltas(delta_a=(0.5, 0, 0, 0, 0, 2))
    assert both.delta_a == (1.5, 0.0, 0.0, 0.0, 0.0, 2.0)
    with pytest.raises(ValueError, match="delta_d needs 6"):
        LinkDeltas(delta_d=(0.0,))


def test_an_unknown_model_is_named_with_the_known_ones() -> None:
    with pytest.raises(ValueError, match=r"'ur11'.*ur10e"):
        chain("ur11")


@given(JOINTS)
@settings(max_examples=30, deadline=None)
def test_the_jacobian_is_the_derivative_of_the_tool_point(q: list[float]) -> None:
    subject = chain("ur5e")
    p = np.array([0.01, -0.02, 0.18])
    J = subject.jacobian(q, p)
    h = 1e-6
    for i in range(6):
        step = h * np.eye(6)[i]
        ahead, behind = subject.matrix(q + step), subject.matrix(q - step)
        point = (ahead @ [*p, 1.0] - behind @ [*p, 1.0])[:3] / (2 * h)
        spin = (ahead[:3, :3] - behind[:3, :3]) / (2 * h) @ subject.matrix(q)[:3, :3].T
        assert np.allclose(J[:3, i], point, atol=1e-7)
        assert np.allclose(J[3:, i], [spin[2, 1], spin[0, 2], spin[1, 0]], atol=1e-7)


@given(st.lists(st.floats(-0.15, 0.15), min_size=6, max_size=6))
@settings(max_examples=30, deadline=None)
def test_inverse_kinematics_find_the_joints_near_the_start(offset: list[float]) -> None:
    subject = chain("ur10e")
    wanted = Q + offset
    assert np.max(np.abs(subject.inverse(subject.forward(wanted), Q) - wanted)) < 1e-8


def test_inverse_kinematics_cross_a_half_turn(subject: Chain) -> None:
    wanted = Q + np.array([0, 0, 0, 0, 0, 3.0])
    found = subject.inverse(subject.forward(wanted), Q)
    assert np.max(np.abs(subject.matrix(found) - subject.matrix(wanted))) < 1e-9


def test_a_pose_out_of_reach_is_refused_with_what_is_left(subject: Chain) -> None:
    far: RigidTransform = from_pose6([2.0, 0.0, 0.5, 0.0, 0.0, 0.0])
    with pytest.raises(UnreachableError, match="mm and"):
        subject.inverse(far, Q)


@pytest.mark.parametrize("angle", [0.0, 1e-160, 1e-9, 2e-5, 0.00999, 0.01001, 0.3, 3.0])
def test_a_displacement_is_the_exponential_of_an_independent_library(angle: float) -> None:
    axis = np.array([0.36, -0.48, 0.8])
    xi = np.concatenate([[2e-5, -0.3, 0.7], angle * axis])
    assert displacement(xi) == pytest.approx(exp_xi(xi).as_matrix(), abs=1e-14)
