"""Arms of every ROBOT family against their links multiplied out, and the derivatives of their parameters."""

import csv
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calibration.kinematics import UrArmModel, robot_from_spec
from calibration.kinematics.chain import SerialChain
from calibration.kinematics.families import arm_spec, chain_parameters, robot_document, ur_chain
from calibration.kinematics.hayati import in_dh_form, with_near_frames
from calibration.kinematics.parametric import ParametricArm
from cell.errors import CellError
from cell.formats.robot import parse_robot
from cell.poses import Array
from tests.kit.kincal_scene import PALLETIZER, joints, link, make_scene, palletizer_flange, ur_flange

FACTORY = {
    "delta_theta": [1e-7, -0.2319237455, 6.5022221386, 0.0128800873, -7e-8, -7e-7],
    "delta_d": [2.3e-4, -204.0771054, 203.3923236, 0.6852734487, -1.25e-4, -1.3e-4],
    "delta_a": [1.4e-4, 0.0111645466, -7.3e-5, 1.9e-4, 1.5e-6, 0.0],
    "delta_alpha": [2.6e-4, 4.78915e-4, 0.0073808844, 2.5e-4, 1.8e-3, 0.0],
}
GANTRY = {
    "family": "serial",
    "links": [
        {"d": 0.4, "alpha": -1.2, "joint": "prismatic"},
        {"theta": 0.3, "a": 0.2, "alpha": 0.9},
        {"d": 0.1, "a": 0.05, "joint": "fixed"},
        {"theta": 0.1, "d": 0.2, "a": 0.3, "beta": 0.01},
        {"alpha": 0.2},
    ],
    "coupling": [[1.0, 0, 0], [0, 1.1, 0], [0, 0.5, -2.0], [0, 0, 1.0]],
}


def arm_of(robot: dict[str, Any]) -> ParametricArm:
    return arm_spec(parse_robot(robot, "robot")).arm


def test_the_palletizer_is_its_table_multiplied_out() -> None:
    table = make_scene("palletizer", 3).truth.table
    arm = arm_of({"family": "palletizer4", "parameters": table})
    Q = joints("palletizer", np.random.default_rng(0), 30)
    found = arm.base.flange(Q)
    np.testing.assert_allclose(found, palletizer_flange(table, Q), atol=1e-12)
    np.testing.assert_allclose(found[:, 2, :3], [[0.0, 0.0, 1.0]] * 30, atol=1e-12)


def test_at_home_the_palletizer_stretches_upper_arm_up_and_forearm_forward() -> None:
    T = arm_of({"family": "palletizer4", "parameters": PALLETIZER}).base.flange(
        np.radians([[0.0, 90.0, -90.0, 0.0]])
    )[0]
    p = PALLETIZER
    reach = p["a1"] + p["a3"] + p["a4"] + p["a5"]
    np.testing.assert_allclose(T[:3, 3], [reach, 0.0, p["d1"] + p["a2"] + p["d5"]], atol=1e-12)
    np.testing.assert_allclose(T[:3, :3], np.eye(3), atol=1e-12)


def test_a_serial_chain_is_its_links_multiplied_out_with_the_coupling_of_its_moving_links() -> None:
    rng = np.random.default_rng(1)
    for q in rng.uniform(-1, 1, (20, 3)):
        expected = (
            link(0, 0.4 + q[0], 0, -1.2)
            @ link(0.3 + 1.1 * q[1], 0, 0.2, 0.9)
            @ link(0, 0.1, 0.05, 0)
            @ link(0.1 + 0.5 * q[1] - 2.0 * q[2], 0.2, 0.3, 0, 0.01)
            @ link(q[2], 0, 0, 0.2)
        )
        np.testing.assert_allclose(arm_of(GANTRY).base.flange(q[None])[0], expected, atol=1e-12)


def test_adjusted_parameters_move_the_arm_as_a_table_with_them_would() -> None:
    rng = np.random.default_rng(2)
    drawn = arm_of({"family": "palletizer4", "parameters": PALLETIZER})
    table = {name: v + 1e-2 * rng.normal() for name, v in PALLETIZER.items()}
    chain = drawn.chain(np.array([table[name] for name in drawn.names]))
    Q = joints("palletizer", rng, 10)
    np.testing.assert_allclose(chain.flange(Q), palletizer_flange(table, Q), atol=1e-12)
    rows = rng.normal(size=(6, 5)) * 1e-2
    ur = arm_of({"model": "ur10e"})
    moved = ur.nominal + [rows[int(n[-1]) - 1, ["t", "d", "a", "l", "b"].index(_first(n))] for n in ur.names]
    rows[[0, 3, 4, 5], 4] = 0.0
    nominal = np.column_stack(
        [np.zeros(6), *(getattr(ur_chain("ur10e"), k) for k in ("d", "a", "alpha", "beta"))]
    )
    Q = joints("ur10e", rng, 10)
    expected = ur_flange(nominal + rows, Q)
    np.testing.assert_allclose(ur.chain(moved).flange(Q), expected, atol=1e-12)


def _first(name: str) -> str:
    return "l" if name.startswith("alpha") else name[0]


@pytest.mark.parametrize(
    "robot",
    [
        {"family": "palletizer4", "parameters": PALLETIZER},
        {"model": "ur10e"},
        GANTRY | {"prior": {"ratio": 1e-3}},
    ],
)
def test_every_derivative_agrees_with_finite_differences(robot: dict[str, Any]) -> None:
    subject, rng = arm_of(robot), np.random.default_rng(3)
    Q, tool = rng.uniform(-2, 2, (5, subject.joints)), np.array([[0.1], [0.2], [0.3]])
    x = subject.nominal + 1e-2 * rng.normal(size=len(subject.nominal))
    walk = subject.chain(x).walk(Q)
    J = subject.columns(Q, walk, walk.point(tool))
    assert len(J) == len(subject.names) == len(subject.kinds)
    for k, step in enumerate(np.eye(len(x)) * 1e-6):
        ahead, behind = (subject.chain(x + s).walk(Q).point(tool) for s in (step, -step))
        np.testing.assert_allclose(J[k], (ahead - behind) / 2e-6, atol=2e-8, err_msg=subject.names[k])


def test_the_joint_jacobian_counts_motors_not_links() -> None:
    chain, q, step = arm_of(GANTRY).base, np.array([0.2, -0.4, 0.7]), 1e-6
    J = chain.jacobians(chain.frames(q[None]))[0]
    for j in range(3):
        dq = np.zeros(3)
        dq[j] = step
        ahead, behind = chain.flange(np.array([q + dq, q - dq]))
        np.testing.assert_allclose(J[:3, j], (ahead - behind)[:3, 3] / (2 * step), atol=1e-8)
        spin = (ahead - behind)[:3, :3] @ chain.flange(q[None])[0, :3, :3].T / (2 * step)
        np.testing.assert_allclose(J[3:, j], [spin[2, 1], spin[0, 2], spin[1, 0]], atol=1e-8)


def test_a_factory_calibration_is_the_same_arm_without_its_far_frames() -> None:
    arm = arm_of({"model": "ur10e", "calibration": FACTORY})
    assert np.max(np.abs(arm.base.d)) < 0.2
    assert np.max(np.abs(arm.base.theta)) < 0.1
    Q = np.random.default_rng(4).uniform(-3, 3, (30, 6))
    expected = robot_from_spec({"model": "ur10e", "calibration": FACTORY}).forward_many(Q).as_matrix()
    np.testing.assert_allclose(arm.base.flange(Q), expected, atol=1e-11)


def test_the_dh_form_of_a_factory_arm_is_the_factory_table_again() -> None:
    chain, drawn = in_dh_form(arm_of({"model": "ur10e", "calibration": FACTORY}).base), ur_chain("ur10e")
    for name, tolerance in (("theta", 1e-7), ("d", 1e-6), ("a", 1e-7), ("alpha", 1e-9)):
        delta = getattr(chain, name) - getattr(drawn, name)
        wanted = np.array(FACTORY[f"delta_{name}"])
        if name == "theta":
            delta, wanted = (np.arctan2(np.sin(v), np.cos(v)) for v in (delta, wanted))
        np.testing.assert_allclose(delta, wanted, atol=tolerance)


small = st.floats(-0.01, 0.01)


@settings(max_examples=40, deadline=None)
@given(st.lists(small, min_size=10, max_size=10))
def test_both_forms_of_an_arm_put_its_flange_in_the_same_place(errors: list[float]) -> None:
    drawn = ur_chain("ur5e")
    e = np.array(errors)
    alpha, beta, theta = drawn.alpha.copy(), np.zeros(6), drawn.theta.copy()
    alpha[1:3] += e[:2]
    beta[1:3] = e[2:4]
    theta[1:5] += e[4:8]
    a = drawn.a + np.array([0, *e[8:], 0, 0, 0])
    chain = SerialChain(theta, drawn.d, a, alpha, beta, drawn.sliding, drawn.coupling)
    Q = np.random.default_rng(5).uniform(-3, 3, (8, 6))
    pure = in_dh_form(chain)
    assert not np.any(pure.beta)
    far = 1e-15 * (1.0 + np.max(np.abs(pure.d)))
    np.testing.assert_allclose(pure.flange(Q), chain.flange(Q), atol=1e-12 + 1e2 * far)
    if np.max(np.abs(pure.d)) < 1e5:
        back = with_near_frames(pure, (1, 2), (0.0, 0.0))
        np.testing.assert_allclose(back.flange(Q), chain.flange(Q), atol=1e-11 + 1e3 * far)


def test_a_calibrated_arm_written_as_robot_and_read_again_is_the_same_arm() -> None:
    rng = np.random.default_rng(6)
    for robot in ({"family": "palletizer4", "parameters": PALLETIZER}, {"model": "ur10e"}, GANTRY):
        spec = arm_spec(parse_robot(robot, "robot"))
        x = spec.arm.nominal + 1e-3 * rng.normal(size=len(spec.arm.nominal))
        place = np.array([0.11, 0.04, -0.09])
        document = robot_document(spec, spec.arm, x, {"smr1": place})
        again = arm_spec(parse_robot(document, "robot"))
        Q = rng.uniform(-2, 2, (5, spec.arm.joints))
        np.testing.assert_array_equal(again.arm.base.flange(Q), spec.arm.chain(x).flange(Q))
        np.testing.assert_array_equal(again.tools["smr1"], place)


@pytest.mark.data
def test_the_adjustable_arm_reproduces_what_a_real_controller_reports(data_folder: Path) -> None:
    folder = data_folder / "ur5_controller_fk"
    if not folder.is_dir():
        pytest.skip(f"no controller data at {folder}")
    text = (folder / "calibration.conf").read_text("utf-8")
    calibration = {
        key: [float(v) for v in re.search(rf"{key} = \[(.*?)\]", text)[1].split(",")]  # type: ignore[index]
        for key in FACTORY
    }
    with (folder / "joint-eef-data.csv").open(encoding="utf-8") as file:
        rows = np.array([[float(v) for v in row] for row in list(csv.reader(file))[1:] if row])
    arm = arm_of({"model": "ur5e", "calibration": calibration})
    off_mm = np.linalg.norm(1e3 * arm.base.flange(np.radians(rows[:, :6]))[:, :3, 3] - rows[:, 6:9], axis=1)
    assert np.sqrt(np.mean(off_mm**2)) < 0.05
    assert np.max(off_mm) < 0.09


def test_the_adjustable_ur_arm_agrees_with_the_one_that_is_moved() -> None:
    Q = np.random.default_rng(7).uniform(-3, 3, (20, 6))
    np.testing.assert_allclose(
        arm_of({"model": "ur20"}).base.flange(Q), UrArmModel("ur20").forward_many(Q).as_matrix(), atol=1e-12
    )


def test_a_chain_of_one_parameter_per_number_names_them_in_order() -> None:
    arm: ParametricArm = chain_parameters(ur_chain("ur3e"), [1, 2], [], "ur")
    assert len(arm.names) == 26
    assert (arm.names[0], arm.names[6], arm.names[-1]) == ("theta1", "d1", "beta3")


@pytest.mark.parametrize(
    ("robot", "needle"),
    [
        ({}, "neither 'model' nor 'family'"),
        ([1], "must be a table"),
        ({"family": "palletiser4"}, "did you mean 'palletizer4'"),
        ({"model": "ur9"}, "'ur9' is not supported"),
        ({"family": "palletizer4", "parameters": {**PALLETIZER, "k4": 1.0}}, "k4"),
        ({"family": "palletizer4", "parameters": {"a1": 1.0}}, "is missing"),
        ({"family": "palletizer4", "parameters": PALLETIZER, "tool": {"smr1": [0, 0, 1]}}, "differs from tx"),
        ({"family": "serial", "links": [{"joint": "fixed"}]}, "no link that moves"),
        ({"family": "serial", "links": [{}, {}], "coupling": [[1.0]]}, "must have 2 rows"),
        ({"family": "serial", "links": [{}, {}], "coupling": [[1.0], [1.0, 2.0]]}, "of equal length"),
        ({"family": "serial", "links": [{"gamma": 1.0}]}, "gamma"),
        ({"model": "ur10e", "calibration": {"delta_d": [0.0] * 5}}, "delta_d"),
        ({"model": "ur10e", "prior": {"length_m": 0.0}}, "length_m"),
        ({"model": "ur10e", "tool": {"smr1": [0.0, 1.0]}}, "tool"),
    ],
)
def test_a_wrong_robot_is_refused_with_the_field_named(robot: Any, needle: str) -> None:
    with pytest.raises(CellError) as caught:
        arm_spec(parse_robot(robot, "data.json: robot"), "data.json: robot")
    assert caught.value.name == "DATA_INVALID"
    assert needle in str(caught.value)
    assert "data.json" in str(caught.value)


def columns_of(chain: SerialChain) -> Array:
    return np.stack([chain.theta, chain.d, chain.a, chain.alpha, chain.beta])


def test_a_chain_whose_axes_are_parallel_keeps_its_numbers_in_dh_form() -> None:
    drawn = ur_chain("ur5e")
    np.testing.assert_array_equal(columns_of(in_dh_form(drawn)), columns_of(drawn))
