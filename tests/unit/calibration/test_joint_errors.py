"""Errors of gears and sag: found from a tracker's readings, and carried wherever the arm goes."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation
from scipy.special import chdtri

from calibration.identification.estimator import Problem
from calibration.identification.joint_errors import errors_of, extended
from calibration.identification.model import Model, make_model
from calibration.identification.solution import identify
from calibration.kinematics import robot_from_spec
from calibration.kinematics.families import arm_spec, robot_document
from calibration.kinematics.spec import measured_arm
from cell.errors import InputError
from cell.formats.robot import parse_robot
from cell.poses import Array

PALLETIZER = {
    "a1": 0.3, "a2": 1.2, "a3": 1.1, "a4": 0.2, "a5": 0.05, "d1": 0.8, "d5": -0.2,
    "k1": 1.0, "k2": 1.0, "k3": 1.0, "k5": -1.0, "t1": 0.0, "t2": 0.0, "t3": 0.0, "t5": 0.0,
    "tx": 0.1, "ty": 0.05, "tz": -0.1,
}  # fmt: skip
ROBOTS: dict[str, dict[str, Any]] = {
    "ur10e": {"model": "ur10e", "tool": {"smr1": [0.03, 0.05, 0.12]}},
    "palletizer": {"family": "palletizer4", "parameters": PALLETIZER},
}
LOW = {"ur10e": (-2.9, -2.6, -2.4, -3.0, -2.6, -3.0), "palletizer": (-2.5, 0.6, -2.4, -3.0)}
HIGH = {"ur10e": (2.9, -0.4, 2.4, 3.0, 2.6, 3.0), "palletizer": (2.5, 2.3, -0.6, 3.0)}
ERRORS = {"gear": 2e-5, "sag": 1e-4}
SIZES = {"length": 5e-4, "angle": 1e-3, "ratio": 3e-4}


def plain(kind: str, prior: dict[str, float] | None = None) -> Model:
    robot = ROBOTS[kind] | ({} if prior is None else {"prior": prior})
    return make_model(arm_spec(parse_robot(robot, "robot")), ["smr1"])


def measured(
    kind: str, seed: int, count: int, gear: float, sag: float
) -> tuple[Problem, Array, Array, Array]:
    """Readings with 30 um of noise of an arm with such errors; the truth at 200 other joints; its numbers."""
    rng = np.random.default_rng(seed)
    model = extended(plain(kind), ERRORS)
    sd = np.array([SIZES[k] for k in model.kinds])
    sd[~model.geometric] = [
        gear if n.startswith("gear") else sag for n in np.array(model.names)[~model.geometric]
    ]
    x = model.nominal + sd * rng.normal(size=model.size)
    Q, elsewhere = (rng.uniform(LOW[kind], HIGH[kind], (n, len(LOW[kind]))) for n in (count, 200))
    T = RigidTransform.from_components([3.0, 1.5, 1.0], Rotation.from_rotvec(rng.normal(size=3))).inv()
    one = np.zeros(max(count, 200), dtype=np.int64)
    p, truth = (T.apply(model.points(x, at, one[: len(at)]).T) for at in (Q, elsewhere))
    return Problem(plain(kind), Q, (p + 3e-5 * rng.normal(size=p.shape)).T, one[:count]), elsewhere, truth, x


@pytest.mark.parametrize("kind", ["ur10e", "palletizer"])
def test_predictions_are_as_good_as_they_say_though_gears_and_sag_are_not_perfect(kind: str) -> None:
    inside, off, off_geometry = [], [], []
    for seed in range(5):
        problem, Q, truth, _ = measured(kind, seed, 120, 50e-6, 300e-6)
        subject = identify(problem, {}, joint_errors=True)
        p, cov = subject.predict(Q)
        assert cov is not None
        away = p - truth
        inside.append(np.einsum("ni,nij,nj->n", away, np.linalg.inv(cov), away) < chdtri(3, 0.05))
        off.append(np.sum(away**2, axis=1))
        off_geometry.append(np.sum((identify(problem, {}).predict(Q)[0] - truth) ** 2, axis=1))
    print(
        f"{kind}: {1e6 * np.sqrt(np.mean(off)):.1f} um, {1e6 * np.sqrt(np.mean(off_geometry)):.1f} um without"
    )
    assert np.mean(off) < 0.1 * np.mean(off_geometry)
    assert 0.85 < np.mean(inside) < 0.99


def test_an_arm_without_such_errors_pays_next_to_nothing_for_the_question() -> None:
    with_them, without = [], []
    for seed in range(8):
        problem, Q, truth, _ = measured("ur10e", 100 + seed, 120, 0.0, 0.0)
        for found, errors in ((with_them, True), (without, False)):
            found.append(np.mean(np.sum((identify(problem, {}, errors).predict(Q)[0] - truth) ** 2, axis=1)))
    assert np.sqrt(np.mean(with_them) / np.mean(without)) < 1.06


def test_what_a_robot_says_of_its_gears_and_its_sag_is_heard() -> None:
    problem, _, _, _ = measured("ur10e", 0, 30, 2e-5, 1e-4)
    unsaid = identify(problem, {}, joint_errors=True).model
    assert unsaid.arm.errors
    none = {"gear_rad": 1e-7, "sag_rad": 1e-7}
    said = replace(problem, model=plain("ur10e", none))
    assert not identify(said, {}, joint_errors=True).model.arm.errors
    usual = replace(problem, model=plain("ur10e", {"gear_rad": 2e-5, "sag_rad": 1e-4}))
    np.testing.assert_allclose(identify(usual, {}, joint_errors=True).model.sd, unsaid.sd)


def test_too_few_readings_ask_for_no_such_errors() -> None:
    problem = measured("ur10e", 3, 18, 50e-6, 300e-6)[0]
    assert not identify(problem, {}, joint_errors=True).model.arm.errors


@pytest.mark.parametrize("kind", ["ur10e", "palletizer"])
def test_the_derivatives_are_those_of_the_points(kind: str) -> None:
    problem, _, _, x = measured(kind, 5, 7, 1e-4, 1e-4)
    subject = extended(problem.model, ERRORS)
    f, J = subject.linearised(x, problem.Q, problem.target)
    for k in range(subject.size):
        step = 1e-6 * (np.arange(subject.size) == k)
        ends = [subject.points(x + sign * step, problem.Q, problem.target) for sign in (1.0, -1.0)]
        np.testing.assert_allclose(J[k], (ends[0] - ends[1]) / 2e-6, atol=4e-3, err_msg=subject.names[k])
    assert f.shape == (3, 7)


@pytest.mark.parametrize("kind", ["ur10e", "palletizer"])
def test_the_robot_document_is_the_arm_with_its_errors(kind: str) -> None:
    model = extended(plain(kind), ERRORS)
    _, Q, _, x = measured(kind, 6, 5, 1e-4, 3e-4)
    spec, own = arm_spec(parse_robot(ROBOTS[kind], "robot")), len(model.arm.names)
    document = robot_document(spec, model.arm, x[:own], {"smr1": x[own:]})
    read = arm_spec(parse_robot(document, "robot")).arm.base
    np.testing.assert_allclose(read.flange(Q), model.arm.chain(x[:own]).flange(Q), atol=1e-12)
    names = {error["name"] for error in document["joint_errors"]}
    assert {"gear1.1", "gear2.2", "sag2.upper", "sag2.fore", "sag3.fore"} <= names


def test_an_arm_that_is_moved_by_what_was_measured_has_its_errors_too() -> None:
    model = extended(plain("ur10e"), ERRORS)
    _, Q, _, x = measured("ur10e", 6, 5, 1e-4, 3e-4)
    own = len(model.arm.names)
    spec = arm_spec(parse_robot(ROBOTS["ur10e"], "robot"))
    document = robot_document(spec, model.arm, x[:own], {})
    subject = measured_arm({"model": "ur10e"}, document)
    np.testing.assert_allclose(
        subject.forward_many(Q).as_matrix(), model.arm.chain(x[:own]).flange(Q), atol=1e-12
    )
    for q in Q[:20]:
        found = subject.inverse(subject.forward(q), q + 0.01)
        assert found is not None
        np.testing.assert_allclose(found, q, atol=1e-8)
    believed = robot_from_spec({"model": "ur10e"}).forward_many(Q).translation
    assert np.linalg.norm(subject.forward_many(Q).translation - believed, axis=1).max() > 1e-3


def test_the_load_of_a_parallelogram_goes_with_the_angles_of_its_links() -> None:
    subject = errors_of(plain("palletizer"), ["sag"])
    assert subject.names == ("sag2.upper", "sag2.fore", "sag3.fore")
    np.testing.assert_array_equal(subject.of, [[0, 1, 0, 0], [0, 1, 1, 0], [0, 1, 1, 0]])


@pytest.mark.parametrize(
    ("change", "words"),
    [({"joint": 7}, "is of joint 7"), ({"of": [1.0]}, "has 1 numbers in 'of'"), ({"sin": 9.0}, "sin")],
)
def test_errors_that_do_not_fit_the_robot_are_refused(change: dict[str, Any], words: str) -> None:
    document = robot_document(
        arm_spec(parse_robot(ROBOTS["palletizer"], "robot")),
        extended(plain("palletizer"), ERRORS).arm,
        extended(plain("palletizer"), ERRORS).nominal[:-3],
        {},
    )
    document["joint_errors"][0] |= change
    with pytest.raises(InputError, match=words):
        parse_robot(document, "robot")
