"""Thousands of poses, in one placement or in hundreds: an answer in bounded memory, and the same figures."""

import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from calibration.hand_eye import se3
from calibration.hand_eye.closed_form import pairs
from calibration.hand_eye.leave_out import leave_one_out, leave_out
from calibration.hand_eye.noise import weights
from calibration.hand_eye.normal import (
    each_group,
    gathered,
    linearise,
    normal,
    own_normal,
    pseudo_inverse,
    squared_distances,
)
from calibration.hand_eye.robust import robust_fit
from calibration.hand_eye.solution import Measurements, Solution, prepare, solve
from calibration.hand_eye.spread import placements, spread_within
from cell.errors import InputError
from cell.poses import to_pose6
from tests.kit.hand_eye_scene import X_TRUE, Scene, make_scene
from tests.kit.solved import solve_hand_eye

RNG = np.random.default_rng


def bare(scene: Scene) -> Measurements:
    """Poses of the target instead of corners: quick to make."""
    rng, n = RNG(5), len(scene.flange)
    noise = [
        RigidTransform.from_components(rng.normal(size=3) * 1e-4, Rotation.from_rotvec(v))
        for v in rng.normal(size=(n, 3)) * 2e-4
    ]
    C = np.stack([(T * N).as_matrix() for T, N in zip(scene.camera_target, noise, strict=True)])
    F = np.stack([T.as_matrix() for T in scene.flange])
    return Measurements("eye-in-hand", F, scene.group, [None] * n, C, np.eye(4)[None])


def solved(scene: Scene) -> Solution:
    found = solve(bare(scene), None, {})
    assert isinstance(found, Solution)
    return found


@pytest.mark.parametrize("groups", [1, 250])
def test_poses_by_the_thousand_are_solved_as_well_as_their_number_promises(groups: int) -> None:
    scene = make_scene(1, count=2500, groups=groups)
    subject = solved(scene)
    e = se3.log(np.linalg.inv(X_TRUE.as_matrix()) @ subject.at.X)
    assert e @ np.linalg.solve(subject.cov, e) < 22.5
    assert subject.excess == 1.0


@pytest.mark.parametrize("groups", [1, 20])
def test_the_report_of_a_thousand_poses_takes_no_square_of_them(groups: int) -> None:
    subject = solved(make_scene(2, count=1000, groups=groups))
    lin = linearise(subject.problem, subject.at)
    P = weights(lin, subject.noise)
    tracemalloc.start()
    leave_one_out(lin, P)
    spread_within(placements(subject.problem, subject.at, P, subject.problem.cov_px))
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 40e6  # one (n, n) array of 6 x 6 blocks alone has 288e6


@pytest.mark.parametrize("groups", [1, 4])
def test_leaving_one_out_at_once_equals_leaving_them_out_one_by_one(groups: int) -> None:
    subject = solved(make_scene(3, count=24, groups=groups))
    lin = linearise(subject.problem, subject.at)
    P = weights(lin, subject.noise)
    at_once, one_by_one = leave_one_out(lin, P), leave_out(lin, P, [np.array([i]) for i in range(24)])
    assert np.array_equal(at_once.rows, one_by_one.rows)
    assert at_once.t == pytest.approx(one_by_one.t, rel=1e-6)
    assert at_once.r == pytest.approx(one_by_one.r, rel=1e-6)


def test_the_noise_floor_of_the_triples_is_that_of_their_whole_maps() -> None:
    subject = solved(make_scene(4, count=9))
    P = weights(linearise(subject.problem, subject.at), subject.noise)
    a = RNG(0).normal(size=(9, 6, 6))
    perfect = 1e-8 * a @ np.swapaxes(a, 1, 2)
    (found,) = placements(subject.problem, subject.at, P, perfect)
    maps = np.zeros((9, 9, 6, 6))
    for k, (rows, gains) in enumerate(zip(found.rows, found.gains, strict=True)):
        maps[k, rows] = gains
    centred = maps - maps.mean(axis=0)
    whole = np.einsum("knab,nbc,kndc->ad", centred, perfect, centred) / 8
    assert found.floor() == pytest.approx(whole, rel=1e-9, abs=1e-9 * np.abs(whole).max())


def test_contributions_are_added_up_by_group_in_any_order() -> None:
    subject = solved(make_scene(5, count=12, groups=3))
    lin = linearise(subject.problem, subject.at)
    own, g = own_normal(lin, weights(lin, subject.noise))
    group = np.array([2, 0, 0, 2, 3, 3, 0, 2, 3, 3, 0, 0])
    summed = gathered(own, g, group, 5)
    for k in range(5):
        assert summed.own[k] == pytest.approx(own[group == k].sum(axis=0))
        assert summed.g[k] == pytest.approx(g[group == k].sum(axis=0))


def test_equations_of_groups_in_any_order_are_those_of_each_observation() -> None:
    found = solved(make_scene(5, count=12, groups=3))
    for order in (np.arange(12), RNG(6).permutation(12)):
        lin = linearise(found.problem.take(order), found.at)
        weight = weights(lin, found.noise)
        subject = normal(lin, weight)
        summed = gathered(*own_normal(lin, weight), lin.problem.group, lin.problem.groups)
        for one, other in ((subject.own, summed.own), (subject.g, summed.g)):
            np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-12 * np.abs(other).max())


@pytest.mark.parametrize("group", [[], [3], [0, 0, 2], [2, 0, 2]])
def test_each_row_is_in_its_group(group: list[int]) -> None:
    rows = np.array(group, dtype=np.int64)
    found = {one: np.arange(len(rows))[own].tolist() for one, own in each_group(rows)}
    assert found == {one: [k for k, g in enumerate(group) if g == one] for one in set(group)}


def test_a_matrix_without_information_does_not_change_the_others() -> None:
    half = RNG(4).normal(size=(3, 6, 6))
    N = half @ np.swapaxes(half, 1, 2)
    N[1, 3:] = N[1, :, 3:] = 0.0
    found = pseudo_inverse(N)
    for k in (0, 2):
        assert found[k] @ N[k] == pytest.approx(np.eye(6), abs=1e-8)
    assert found[1, :3, :3] @ N[1, :3, :3] == pytest.approx(np.eye(3), abs=1e-8)
    assert not found[1, 3:].any()


def test_pairs_of_groups_of_several_sizes_are_all_there_are() -> None:
    group = np.array([2, 0, 0, 2, 3, 3, 0, 2, 3, 3, 0, 5])
    every = {(i, j) for j in range(12) for i in range(j) if group[i] == group[j]}
    found = [(int(i), int(j)) for i, j in zip(*pairs(group), strict=True)]
    assert len(found) == len(every)
    assert set(found) == every


@pytest.mark.parametrize("groups", [1, 30])
def test_distances_are_in_units_of_the_noise_that_all_observations_have(groups: int) -> None:
    problem = prepare(bare(make_scene(5, count=300, groups=groups)), None)
    subject = robust_fit(problem, {})
    P = weights(subject.lin, subject.noise)
    assert subject.weight == pytest.approx(P, rel=1e-9)
    squared = squared_distances(subject.lin.r, P)
    assert subject.distance[subject.used] == pytest.approx(np.sqrt(squared / 6.0), rel=1e-9)


def test_a_direction_that_rounding_leaves_below_zero_has_no_information() -> None:
    N = np.diag([4.0, 1.0, 1.0, 1.0, 1.0, -1e-12])[None]
    N[0, 0, 5] = N[0, 5, 0] = 1e-9
    assert pseudo_inverse(N)[0] == pytest.approx(np.diag([0.25, 1.0, 1.0, 1.0, 1.0, 0.0]))


def test_a_method_that_takes_the_square_of_the_poses_refuses_thousands(tmp_path: Path) -> None:
    scene = make_scene(6, count=1200)
    observations: list[dict[str, Any]] = [
        {"index": i, "T_base_flange": to_pose6(F).tolist(), "T_camera_target": to_pose6(C).tolist()}
        for i, (F, C) in enumerate(zip(scene.flange, scene.camera_target, strict=True))
    ]
    path = scene.write(tmp_path, observations=observations)
    with pytest.raises(InputError, match="'park' takes the square of the 1200 poses of one placement; use"):
        solve_hand_eye(path, method="park")
