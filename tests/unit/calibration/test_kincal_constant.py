"""A reflector's constant that is not quite right: what is stated of it is in the uncertainty, and covers."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calibration.identification.estimator import Problem
from calibration.identification.range_offset import range_offset
from calibration.identification.reflector_constant import (
    constant_of,
    identify_with_constant,
    open_constant,
    unnoticed,
)
from calibration.identification.solution import identify
from calibration.lengths import lengths95
from tests.kit.kincal_scene import SIGMA0, SIGMA_PER_M, Scene, joints, make_scene
from tests.kit.solved import solve_kincal

NOISE = {"sigma0": SIGMA0, "sigma_per_m": SIGMA_PER_M}
KINDS = pytest.mark.parametrize("kind", ["ur10e", "palletizer"])
POSES, SEEDS = 40, 10


def with_offset(problem: Problem, offset_m: float) -> Problem:
    """Ranges too long by ``offset_m``."""
    return replace(problem, p=problem.p * (1.0 + offset_m / problem.range_m))


@KINDS
def test_predictions_are_as_sure_as_they_say_when_the_constant_is_as_sure_as_was_stated(kind: str) -> None:
    stated_m = 0.0002
    inside, inside_without, pulls = [], [], []
    for seed in range(SEEDS):
        scene, rng = make_scene(kind, seed, POSES), np.random.default_rng(1000 + seed)
        true_m = stated_m * rng.normal()
        problem, Q = with_offset(scene.problem, true_m), joints(kind, rng, 40)
        truth = scene.truth.p_tracker(Q, ["smr1"] * len(Q))
        for noise, shares in ((NOISE | {"sigma_constant": stated_m}, inside), (NOISE, inside_without)):
            found = identify_with_constant(problem, noise)
            p, cov = found.predict(Q)
            assert cov is not None
            shares.append(np.mean(np.linalg.norm(p - truth, axis=1) < lengths95(cov)))
            if found.constant_sigma_m:
                pulls.append((found.constant_m - true_m) / found.constant_sigma_m)
    assert len(pulls) == SEEDS
    assert 0.5 < np.sqrt(np.mean(np.square(pulls))) < 1.6
    assert np.mean(inside) > 0.85
    assert np.mean(inside_without) < 0.5, "so little was covered before"


@KINDS
def test_what_is_taken_as_right_changes_nothing(kind: str) -> None:
    problem = make_scene(kind, 1, POSES).problem
    plain, found = identify(problem, NOISE), identify_with_constant(problem, NOISE)
    assert found.cov is not None
    assert plain.cov is not None
    assert np.array_equal(found.x, plain.x)
    assert np.array_equal(found.cov, plain.cov)
    assert (found.constant_m, found.constant_sigma_m) == (0.0, 0.0)


@KINDS
def test_a_constant_known_to_micrometres_hardly_changes_predictions(kind: str) -> None:
    problem = make_scene(kind, 2, POSES).problem
    plain = identify(problem, NOISE)
    found = identify_with_constant(problem, NOISE | {"sigma_constant": 1e-5})
    Q = joints(kind, np.random.default_rng(5), 30)
    (p, own), (q, widened) = plain.predict(Q), found.predict(Q)
    assert own is not None
    assert widened is not None
    assert np.linalg.norm(p - q, axis=1).max() < 1e-5
    assert np.all(lengths95(widened) > lengths95(own))
    assert np.median(lengths95(widened) / lengths95(own)) < 1.3


@KINDS
def test_a_plan_promises_what_the_solution_then_states(kind: str) -> None:
    scene, stated_m = make_scene(kind, 3, POSES), 0.0002
    plain = identify(scene.problem, NOISE)
    found = identify_with_constant(scene.problem, NOISE | {"sigma_constant": stated_m})
    assert plain.cov is not None
    assert found.cov is not None
    problem = plain.problem
    f, J = plain.model.linearised(plain.x, problem.Q, problem.target)
    tracker = plain.registration.to_base(np.zeros((3, 1)))
    beams = (f - tracker) / np.linalg.norm(f - tracker, axis=0)
    more = open_constant(plain.cov, J, beams, 1.0 / plain.noise.sigma(problem.range_m), stated_m)
    Q = joints(kind, np.random.default_rng(5), 30)
    planned = replace(plain, cov=plain.cov + more).predict(Q)[1]
    stated = found.predict(Q)[1]
    assert planned is not None
    assert stated is not None
    assert lengths95(planned) == pytest.approx(lengths95(stated), rel=0.02)


@KINDS
def test_a_wrong_constant_of_the_size_that_is_said_to_show_does_show(kind: str) -> None:
    shown = []
    for seed in range(SEEDS):
        problem = make_scene(kind, seed, POSES).problem
        told = constant_of(identify(problem, NOISE))
        assert told is not None
        shown.append(range_offset(identify(with_offset(problem, 1.2 * unnoticed(told)), NOISE)))
    assert sum(found is not None and found.significant for found in shown) >= SEEDS - 2


def solved(scene: Scene, folder: Path, offset_m: float, **noise: float) -> dict[str, object]:
    p = np.array([s["p_tracker"] for s in scene.data["samples"]])
    p *= 1.0 + offset_m / np.linalg.norm(p, axis=1, keepdims=True)
    samples = [{**s, "p_tracker": row.tolist()} for s, row in zip(scene.data["samples"], p, strict=True)]
    return solve_kincal(scene.changed(samples=samples, noise={**NOISE, **noise}).write(folder))


def test_the_result_says_what_was_found_and_what_stays_open(tmp_path: Path) -> None:
    scene = make_scene("ur10e", 4, 60)
    told = solved(scene, tmp_path, 0.0004, sigma_constant=0.0005)
    answer, open_ = told["result"], told["uncertainty"]["reflector_constant"]  # type: ignore[index]
    assert answer["reflector_constant_m"] == pytest.approx(0.0004, abs=4.0 * open_["sigma"])  # type: ignore[index]
    assert 0.0 < open_["sigma"] < open_["readings_sigma"] < 0.0001
    assert open_["unnoticed_error_max"] > 0.8 * open_["unnoticed"] > 4.0 * open_["readings_sigma"]
    silent = solved(scene, tmp_path, 0.0)
    assert silent["result"]["reflector_constant_m"] == 0.0  # type: ignore[index]
    assert silent["uncertainty"]["reflector_constant"]["sigma"] == 0.0  # type: ignore[index]
    worst = [r["uncertainty"]["predicted_95"]["workspace"]["max"] for r in (told, silent)]  # type: ignore[index]
    assert worst[0] > 1.2 * worst[1]
