"""What tracker points can and cannot determine, in numbers and in words."""

import numpy as np
import pytest

from calibration.identification.estimator import Problem
from calibration.identification.observability import Observability, observe, refuse
from tests.kit.kincal_scene import joints, make_scene


def observed(problem: Problem) -> Observability:
    x = problem.model.nominal + 1e-3 * np.random.default_rng(0).normal(size=problem.model.size)
    _, J = problem.model.linearised(x, problem.Q, problem.target)
    return observe(problem, J, np.ones(problem.n), x)


def with_joints(problem: Problem, Q: np.ndarray) -> Problem:
    return Problem(problem.model, Q, problem.p[:, : len(Q)], problem.target[: len(Q)])


def test_the_palletizer_has_rank_11_of_18_and_13_with_the_tracker_known() -> None:
    found = observed(make_scene("palletizer", 0, 50).problem)
    assert (found.rank, found.rank_alone, found.rank_possible) == (11, 13, 11)
    assert found.lacking == ()
    said = found.unidentifiable
    assert len(said) == 6
    for words in ("a1 = a4: only a1 + a4", "a5 = tx: only a5 + tx", "d1 = d5 = tz: only d1 + d5 + tz"):
        assert any(w.startswith(words) for w in said), (words, said)
    assert any(w.startswith("t5 with tx and ty") for w in said)
    assert any(w.startswith("t1: looks like the tracker's") and "turn about base z" in w for w in said)
    assert any(w.startswith("d1: looks like the tracker's") and "shift along base z" in w for w in said)


def test_a_ur_arm_has_rank_21_of_29_and_23_with_the_tracker_known() -> None:
    found = observed(make_scene("ur10e", 0, 50).problem)
    assert (found.rank, found.rank_alone, found.rank_possible) == (21, 23, 21)
    assert len(found.unidentifiable) == 7
    text = "; ".join(found.unidentifiable)
    for pair in ("d2 = d3 = d4", "d6 = smr1.z", "a6 = smr1.x", "theta6 with smr1.x and smr1.y"):
        assert pair in text


def test_more_reflectors_determine_more() -> None:
    tools = {"smr1": (0.1, 0.0, 0.05), "smr2": (-0.08, 0.06, 0.02), "smr3": (0.0, -0.1, 0.1)}
    assert observed(make_scene("ur10e", 0, 60, tools=tools).problem).rank == 27


@pytest.mark.parametrize("kind", ["palletizer", "ur10e"])
def test_a_combination_that_is_called_open_moves_no_reading(kind: str) -> None:
    problem = make_scene(kind, 0, 40).problem
    model, names = problem.model, problem.model.names
    x = model.nominal
    before = model.points(x, problem.Q, problem.target)
    pairs = {
        "palletizer": [("a4", "a1"), ("a5", "tx"), ("d5", "tz")],
        "ur10e": [("d4", "d2"), ("d6", "smr1.z")],
    }
    for left, right in pairs[kind]:
        moved = x.copy()
        moved[names.index(left)] += 1e-3
        moved[names.index(right)] -= 1e-3
        np.testing.assert_allclose(model.points(moved, problem.Q, problem.target), before, atol=1e-12)


def test_a_joint_that_rests_is_named_with_what_it_leaves_open() -> None:
    problem = make_scene("palletizer", 0, 50).problem
    Q = problem.Q.copy()
    Q[:, 1] = 1.5
    still = with_joints(problem, Q)
    found = observed(still)
    assert found.rank < found.rank_possible
    refusal = refuse(still, found, has_prior=False)
    assert refusal is not None
    assert refusal.name == "joint-still"
    assert "joint 2 does not move" in refusal.words
    assert "k2" in refusal.words
    assert refuse(still, found, has_prior=True) is None


def test_joints_that_move_only_together_are_refused() -> None:
    problem = make_scene("palletizer", 0, 50).problem
    Q = problem.Q.copy()
    Q[:, 2] = -Q[:, 1]
    tied = with_joints(problem, Q)
    refusal = refuse(tied, observed(tied), has_prior=False)
    assert refusal is not None
    assert refusal.name == "unobservable"


def test_too_few_samples_and_repeated_ones_are_refused_with_what_is_needed() -> None:
    problem = make_scene("ur10e", 0, 50).problem
    few = with_joints(problem, problem.Q[:9])
    refusal = refuse(few, observed(few), has_prior=False)
    assert str(refusal).startswith("too-few-poses: 9 samples give 27 numbers; 27 unknowns")
    enough = with_joints(problem, problem.Q[:10])
    assert refuse(enough, observed(enough), has_prior=False) is None
    same = with_joints(problem, np.tile(problem.Q[:5], (10, 1)))
    assert str(refuse(same, observed(same), has_prior=False)).startswith("poses-not-distinct: only 5 of 50")


def test_motors_with_gears_are_judged_at_their_links() -> None:
    scene = make_scene("palletizer", 0, 50)
    parameters = scene.data["robot"]["parameters"]
    geared = {**parameters, **{k: 0.01 * parameters[k] for k in ("k1", "k2", "k3", "k5")}}
    scene.data["robot"] = {"family": "palletizer4", "parameters": geared}
    problem = with_joints(scene.problem, 100.0 * joints("palletizer", np.random.default_rng(1), 50))
    found = observed(problem)
    assert (found.rank, found.rank_alone) == (11, 13)
    assert refuse(problem, found, has_prior=False) is None
