"""The twin's palletizer against numbers worked out by hand, and against the solver's other form of it."""

from math import cos, pi, radians, sin, sqrt

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calibration.kinematics.families import arm_spec
from cell.errors import CellError
from cell.formats.robot import parse_robot
from fakes.object import run_virtual
from fakes.world.arm.truth import JointErrorsTruth
from fakes.world.palletizer.joint_errors import palletizer_joint_errors
from fakes.world.palletizer.linkage import Palletizer
from fakes.world.palletizer.observed import ObservedPalletizer, Status
from fakes.world.scenario import Scenario
from fakes.world.world import World
from procedures.twin_arm import observed_flange
from tests.kit.ideal_world import ideal_text

ROUND = Palletizer(
    a1=0.3, a2=1.0, a3=1.2, a4=0.25, a5=0.1, d1=0.8, d5=-0.3,
    k1=1.0, k2=1.0, k3=1.0, k5=-1.0, t1=0.0, t2=0.0, t3=0.0, t5=0.0,
)  # fmt: skip


@pytest.mark.parametrize(
    ("degrees", "position", "yaw_degrees"),
    [
        # Home: upper arm straight up, forearm level. 0.3 + 1.2 + 0.25 + 0.1 out, 0.8 + 1.0 - 0.3 up.
        ((0, 90, -90, 0), (1.85, 0.0, 1.5), 0),
        # Upper arm at 60 degrees, forearm level: out 0.3 + 0.5 + 1.2 + 0.25 + 0.1, up 0.8 + sqrt(3)/2 - 0.3.
        ((0, 60, -60, 0), (2.35, 0.0, 0.5 + sqrt(0.75)), 0),
        # The same, a quarter to the left: q5 counts backwards, so 90 turn the flange back to the front.
        ((90, 60, -60, 90), (0.1, 2.25, 0.5 + sqrt(0.75)), 0),
        # Forearm 30 degrees below the horizon: 1.2 cos 30 out, 0.6 down; the flange is still level.
        ((0, 90, -120, -90), (0.55 + 1.2 * sqrt(0.75), 0.1, 0.9), 90),
    ],
)
def test_the_palletizer_stands_where_a_drawing_puts_it(
    degrees: tuple[float, ...], position: tuple[float, ...], yaw_degrees: float
) -> None:
    T = ROUND.flange(np.radians(degrees))
    np.testing.assert_allclose(T.translation, position, atol=1e-12)
    np.testing.assert_allclose(T.rotation.as_rotvec(), [0, 0, radians(yaw_degrees)], atol=1e-12)


def test_ratios_and_offsets_act_on_the_motor_side() -> None:
    geared = Palletizer(
        **{**vars(ROUND), "k1": 0.5, "t1": 0.1, "k2": 1.01, "t2": -0.02, "k3": 0.99, "t3": 0.03}
    )
    q = [0.4, 1.3, -1.1, 0.0]
    heading, upper = 0.3, 1.01 * 1.3 - 0.02
    fore = upper - 0.99 * 1.1 + 0.03
    out = 0.3 + cos(upper) + 1.2 * cos(fore) + 0.25 + 0.1
    expected = [out * cos(heading), out * sin(heading), 0.5 + sin(upper) + 1.2 * sin(fore)]
    np.testing.assert_allclose(geared.flange(q).translation, expected, atol=1e-12)


@settings(max_examples=30, deadline=None)
@given(st.lists(st.floats(-0.05, 0.05), min_size=15, max_size=15), st.integers(0, 1000))
def test_both_forms_of_the_palletizer_agree(errors: list[float], seed: int) -> None:
    values = {name: v + e for (name, v), e in zip(vars(ROUND).items(), errors, strict=True)}
    table = {**values, "tx": 0.0, "ty": 0.0, "tz": 0.0}
    solver = arm_spec(parse_robot({"family": "palletizer4", "parameters": table}, "robot")).arm.base
    Q = np.random.default_rng(seed).uniform(-pi, pi, (10, 4))
    np.testing.assert_allclose(Palletizer(**values).flange(Q).as_matrix(), solver.flange(Q), atol=1e-12)


def scene() -> tuple[Scenario, ObservedPalletizer]:
    scenario = Scenario.load("palletizer:ideal")
    arm = World.from_scenario(scenario).observed
    assert arm is not None
    return scenario, arm


def test_the_scenarios_palletizer_is_3_to_4_mm_off_what_its_controller_believes() -> None:
    scenario, arm = scene()
    low, high = np.array(arm.truth.limits).T
    Q = np.random.default_rng(0).uniform(low, high, (3000, 4))
    p = arm.truth.parameters
    believed = arm.believed.flange(Q).apply([p.tx, p.ty, p.tz])
    true = arm.true.flange(Q).apply(scenario.world.reflectors["smr1"].point)
    assert 0.003 < rms(believed - true) < 0.004
    a, b = believed - believed.mean(axis=0), true - true.mean(axis=0)
    U, _, Vt = np.linalg.svd(a.T @ b)
    R = (U @ np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))]) @ Vt).T
    assert 0.003 < rms(a @ R.T - b) < 0.004, "no place of the tracker hides the errors"
    assert 2.4 < np.max(np.hypot(*believed.T[:2])) < 3.0


def rms(off: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.sum(off**2, axis=1))))


def test_what_the_controller_believes_is_a_robot_that_the_solver_reads() -> None:
    _, arm = scene()
    solver = arm_spec(parse_robot(arm.truth.robot, "robot"))
    q = np.array(arm.truth.q_start)
    np.testing.assert_allclose(
        arm.believed_flange(0.0).as_matrix(), solver.arm.base.flange(q[None])[0], atol=1e-12
    )
    assert solver.tool_in_parameters == "smr1"
    np.testing.assert_array_equal(solver.tools["smr1"], [0.12, 0.05, -0.06])


def test_the_past_of_the_arm_stays_when_something_new_is_asked() -> None:
    _, arm = scene()
    assert arm.request(1.0, 1, [0.5, 1.3, -1.2, 0.2]) is Status.BUSY
    times = np.linspace(0.0, 2.6, 30)
    before = [arm.joints(t).tolist() for t in times]
    arm.request(2.6, 2, [-0.5, 1.3, -1.2, 0.2])
    assert [arm.joints(t).tolist() for t in times] == before
    assert arm.reached(30.0) == 2
    assert arm.reached(arm.track.end_time - 1e-6) == 0


def test_each_standstill_is_a_little_elsewhere_and_stays_there() -> None:
    _, arm = scene()
    found = []
    for k in range(1, 7):
        arm.request(20.0 * k, k, [0.1 * k, 1.3, -1.2, 0.0])
        at = arm.true_flange(20.0 * k + 15.0)
        np.testing.assert_array_equal(at.as_matrix(), arm.true_flange(20.0 * k + 19.0).as_matrix())
        model = arm.true.flange(arm.track.at(20.0 * k + 15.0)[0])
        found.append(np.linalg.norm(at.translation - model.translation))
    assert len(set(found)) == 6
    assert 0.0 < max(found) < 30e-6


@pytest.mark.parametrize(
    ("old", "new", "finding"),
    [
        ("limits = [[-2.4, 2.4]", "limits = [[2.4, -2.4]", "is not below"),
        ("[0.0, 1.570796, -1.570796, 0.0]", "[0.0, 2.570796, -1.570796, 0.0]", "is not within its limits"),
        ("a5 = 0.0", "a6 = 0.0", "parameters.a6 is not a known key"),
        ('serial = "99995500001"', 'serial = "15"', "serial"),
        ("[world.observed", "[world.observer", "did you mean observed?"),
    ],
)  # fmt: skip
def test_a_wrong_palletizer_in_a_scenario_is_refused_with_its_key(old: str, new: str, finding: str) -> None:

    text = ideal_text("palletizer")
    assert old in text
    with pytest.raises(CellError) as caught:
        Scenario.parse(text.replace(old, new))
    assert finding in str(caught.value)


def test_the_world_knows_where_a_reflector_on_the_observed_arm_is() -> None:
    async def look() -> None:
        world = World.from_scenario(Scenario.load("palletizer:ideal"))
        arm = world.observed
        assert arm is not None
        expected = arm.true_flange(0.0).apply(world.config.reflectors["smr1"].point)
        np.testing.assert_array_equal(world.tracker.visibility.position("smr1", 0.0), expected)
        assert world.truth(0.0)["observed"]["serial"] == "99995500001"

    run_virtual(look())


def test_weight_lets_a_level_arm_sink_and_an_upright_one_stand() -> None:
    errors = palletizer_joint_errors(JointErrorsTruth(sag_rad=[1e-3, 2e-3, 4e-3]), ROUND, 1)
    assert errors is not None
    level = errors.actual(np.zeros(4))
    np.testing.assert_allclose(level, [0.0, -3e-3, -4e-3, 0.0], atol=1e-15)
    assert ROUND.flange(level).translation[2] < ROUND.flange(np.zeros(4)).translation[2] - 0.005
    upright = np.array([0.3, pi / 2, 0.0, 0.2])
    np.testing.assert_allclose(errors.actual(upright), upright, atol=1e-15)
    backwards = Palletizer(**{**vars(ROUND), "k2": -1.0, "t2": 0.4})
    other = palletizer_joint_errors(JointErrorsTruth(sag_rad=[1e-3, 0.0, 0.0]), backwards, 1)
    assert other is not None
    assert other.actual([0.0, 0.4, 0.0, 0.0])[1] == pytest.approx(0.401), "its motor turns the other way"


def test_the_truth_that_is_told_has_the_arm_where_it_stands_gears_and_sag_too() -> None:
    scenario = Scenario.parse(
        ideal_text("palletizer")
        .replace(
            "[world.observed.parameters]",
            "[world.observed.joint_errors]\ngear_once_rad = 0.001\ngear_twice_rad = 0.002\n"
            "sag_rad = [0.001, 0.002, 0.003]\n[world.observed.parameters]",
        )
        .replace("repeatability_t_m = 0.0000139", "repeatability_t_m = 0.0"),
        "test",
    )
    world = World.from_scenario(scenario)
    arm = world.observed
    assert arm is not None
    q = np.array(arm.truth.q_start)
    told = observed_flange(world.truth()["observed"], q[None])[0]
    np.testing.assert_allclose(told, arm.true_flange(0.0).as_matrix(), atol=1e-9)
    assert np.linalg.norm(told[:3, 3] - arm.true.flange(q).translation) > 1e-3
