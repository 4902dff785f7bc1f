"""The hand-eye solution: as good as the data allow, honest about it, and refusing what cannot be known."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from calibration.hand_eye import se3
from calibration.hand_eye.ambiguity import candidates, choose, turns
from calibration.hand_eye.classic import METHODS, solve_classic
from calibration.hand_eye.closed_form import closed_form_X
from calibration.hand_eye.leave_out import held_out, leave_one_out, pose_distances
from calibration.hand_eye.noise import weights
from calibration.hand_eye.normal import gauss_newton, linearise
from calibration.hand_eye.observability import still_pairs
from calibration.hand_eye.pnp import Poses
from calibration.hand_eye.problem import Estimate
from calibration.hand_eye.solution import Solution, prepare, solve
from calibration.hand_eye.spread import placements, spread_across, spread_within
from calibration.refusal import Refusal
from calibration.targets.base import grid_symmetries
from tests.kit.hand_eye_scene import CAMERA, POINTS, X_TRUE, Scene, cone_views, make_scene

TRUE_NOISE = {"sigma_px": 0.2, "sigma_flange_t": 2e-4, "sigma_flange_r": 2e-4}


def solved(scene: Scene, noise: dict[str, float] | None = None) -> Solution:
    answer = solve(scene.measurements(), CAMERA, noise or {})
    assert isinstance(answer, Solution)
    return answer


def error_of(X: np.ndarray) -> np.ndarray:
    return se3.log(se3.inverse(X) @ X_TRUE.as_matrix())


@pytest.mark.parametrize("setup", ["eye-in-hand", "eye-to-hand"])
def test_perfect_data_give_the_exact_answer(setup: str) -> None:
    subject = solved(make_scene(setup=setup, count=12, groups=2, px=0.0, flange_t=0.0, flange_r=0.0))
    assert np.linalg.norm(error_of(subject.at.X)) < 1e-8
    assert subject.used.all()


@pytest.mark.parametrize("setup", ["eye-in-hand", "eye-to-hand"])
def test_errors_reach_the_bound_and_covariance_tells_them_without_given_noise(setup: str) -> None:
    errors, bounds, nees = [], [], []
    for seed in range(40):
        scene = make_scene(seed, setup, count=40, groups=2)
        subject = solved(scene)
        bound = solved(scene, TRUE_NOISE)
        e = error_of(subject.at.X)
        errors.append(e**2)
        bounds.append(np.diag(bound.cov / bound.excess))
        nees.append(e @ np.linalg.solve(subject.cov, e))
    ratio = np.sqrt(
        np.mean(errors, axis=0).reshape(2, 3).sum(1) / np.mean(bounds, axis=0).reshape(2, 3).sum(1)
    )
    assert np.all(ratio < 1.25), ratio  # the bound itself scatters by 10 % with 40 data sets
    assert 5.0 < np.mean(nees) < 7.5


def test_opencv_solvers_agree_with_ours_and_are_worse() -> None:
    ours, theirs = [], {m: [] for m in METHODS}
    for seed in range(10):
        subject = solved(make_scene(seed, count=20))
        ours.append(np.sum(error_of(subject.at.X)[:3] ** 2))
        for method in METHODS:
            X = solve_classic(subject.problem, method)
            assert X is not None
            assert np.linalg.norm(error_of(X)[:3]) < 0.01
            theirs[method].append(np.sum(error_of(X)[:3] ** 2))
    assert all(np.mean(ours) < np.mean(t) for t in theirs.values())


def test_a_wrong_pose_is_rejected_with_a_reason_and_does_no_harm() -> None:
    scene = make_scene(3, count=24)
    clean = solved(scene)
    scene.flange[5] = scene.flange[5] * RigidTransform.from_translation([0.004, 0, 0])
    scene.flange[17] = scene.flange[17] * RigidTransform.from_rotation(Rotation.from_rotvec([0, 0.01, 0]))
    subject = solved(scene)
    assert set(subject.reasons) == {5, 17}
    assert "disagrees" in subject.reasons[5]
    sigma = np.sqrt(np.diag(clean.cov))
    assert np.all(np.abs(se3.log(se3.inverse(clean.at.X) @ subject.at.X)) < sigma)


def test_good_data_are_hardly_ever_rejected() -> None:
    assert sum(len(solved(make_scene(seed, count=20)).reasons) for seed in range(20)) <= 1


def test_given_noise_that_is_too_small_widens_the_covariance_instead_of_rejecting() -> None:
    scene = make_scene(1, count=24)
    subject = solved(scene, {k: v / 5 for k, v in TRUE_NOISE.items()})
    assert subject.used.all()
    assert 12 < subject.excess < 50
    assert np.allclose(np.diag(subject.cov), np.diag(solved(scene, TRUE_NOISE).cov), rtol=0.9)


def test_bare_poses_are_solved_too() -> None:
    scene = make_scene(2, count=20)
    bare = scene.measurements()
    rng = np.random.default_rng(0)
    C = np.stack([T.as_matrix() for T in scene.camera_target])
    noise = se3.exp(np.c_[rng.normal(size=(20, 3)) * 5e-4, rng.normal(size=(20, 3)) * 1e-3])
    bare = type(bare)(bare.setup, bare.F, bare.group, [None] * 20, C @ noise, bare.motions)
    subject = solve(bare, None, {})
    assert isinstance(subject, Solution)
    e = error_of(subject.at.X)
    assert e @ np.linalg.solve(subject.cov, e) < 22.0
    assert subject.noise.sigma["sigma_pose_r"] == pytest.approx(1e-3, rel=0.4)


def _turned(rotvecs: list[list[float]], shifts: np.ndarray) -> list[RigidTransform]:
    base = cone_views(np.random.default_rng(0), 3)[0]
    return [
        RigidTransform.from_components(s, Rotation.from_rotvec(w)) * base
        for w, s in zip(rotvecs, shifts, strict=True)
    ]


def degenerate(name: str, setup: str) -> Scene:
    rng = np.random.default_rng(7)
    shifts = rng.uniform(-0.03, 0.03, (12, 3))
    quiet = {"flange_t": 5e-5, "flange_r": 5e-5, "setup": setup}
    if name == "no-rotation":
        return make_scene(views=_turned([[0, 0, 0]] * 12, shifts), count=12, **quiet)
    if name == "parallel-axes":
        turns_ = [[0.3 * a, 0.8 * a, 0.2 * a] for a in np.linspace(-0.4, 0.4, 12)]
        return make_scene(views=_turned(turns_, shifts), count=12, **quiet)
    if name == "poses-not-distinct":
        one = cone_views(rng, 1)
        return make_scene(views=one * 6, count=6, setup=setup, flange_t=0.0, flange_r=0.0)
    if name == "too-few-poses":
        return make_scene(count=2, **quiet)
    tilt = Rotation.from_rotvec([0.4, 0, 0])
    views = []
    for f in np.arange(12) * np.pi / 6:
        R = tilt * Rotation.from_rotvec([0, 0, f])
        views.append(RigidTransform.from_components([0, 0, 0.5] - R.apply(POINTS.mean(axis=0)), R))
    return make_scene(views=views, count=12, **quiet)


@pytest.mark.parametrize("setup", ["eye-in-hand", "eye-to-hand"])
@pytest.mark.parametrize(
    "name", ["no-rotation", "parallel-axes", "poses-not-distinct", "too-few-poses", "rigid-roll"]
)
def test_data_that_cannot_determine_the_answer_are_refused_by_name(name: str, setup: str) -> None:
    answer = solve(degenerate(name, setup).measurements(), CAMERA, {})
    assert isinstance(answer, Refusal)
    assert answer.name == name
    assert "observable" in answer.words


@pytest.mark.parametrize("setup", ["eye-in-hand", "eye-to-hand"])
def test_turning_about_the_normal_while_moving_about_is_not_called_a_rigid_roll(setup: str) -> None:
    shifts = np.random.default_rng(7).uniform(-0.06, 0.06, (12, 3))
    views = []
    for f, s in zip(np.linspace(-1.0, 1.0, 12), shifts, strict=True):
        R = Rotation.from_rotvec([0, 0, f])
        views.append(
            RigidTransform.from_components(np.array([0, 0, 0.5]) + s - R.apply(POINTS.mean(axis=0)), R)
        )
    answer = solve(make_scene(views=views, count=12, setup=setup).measurements(), CAMERA, {})
    assert isinstance(answer, Refusal)
    assert answer.name == "parallel-axes"


def test_small_but_real_rotations_are_not_refused() -> None:
    scene = make_scene(views=cone_views(np.random.default_rng(2), 16, half_angle=0.06), count=16)
    assert isinstance(solve(scene.measurements(), CAMERA, {}), Solution)


def test_consecutive_poses_without_rotation_are_named() -> None:
    scene = make_scene(count=8, flange_r=0.0)
    scene.flange[4] = RigidTransform.from_translation([0.05, 0, 0]) * scene.flange[3]
    assert [(i, j) for i, j, _ in still_pairs(prepare(scene.measurements(), CAMERA))] == [(3, 4)]


def test_half_turned_boards_are_found_by_the_motion_of_the_arm() -> None:
    scene = make_scene(5, count=20, groups=2)
    symmetries = grid_symmetries(9, 6)
    motions = turns(POINTS, symmetries)
    assert np.allclose(POINTS @ motions[1][:3, :3].T + motions[1][:3, 3], POINTS[symmetries[1]], atol=1e-12)
    problem = prepare(scene.measurements(), CAMERA)
    flipped = np.random.default_rng(1).random(20) < 0.5
    C = problem.C.copy()
    C[flipped] = C[flipped] @ motions[1]
    poses = Poses(C, problem.cov_px, problem.sse, np.full(20, 54))
    options, _ = candidates(poses, np.arange(20), motions)
    chosen = choose("eye-in-hand", problem.G, problem.group, options)
    for g in (0, 1):
        agreed = (chosen == 1)[problem.group == g] == flipped[problem.group == g]
        assert agreed.all() or not agreed.any()


def test_leaving_one_out_equals_solving_without_it() -> None:
    subject = solved(make_scene(6, count=10))
    lin = linearise(subject.problem, subject.at)
    P = weights(lin, subject.noise)
    quick = leave_one_out(lin, P)
    for i in (0, 4, 9):
        rest = np.arange(10) != i
        alone = gauss_newton(subject.problem.take(rest), subject.at, P[rest]).at
        one = subject.problem.take(np.array([i]))
        t, r = pose_distances(one.target_poses(alone.X), alone.W)
        assert quick.t[i] == pytest.approx(t[0], rel=0.02, abs=1e-6)
        assert quick.r[i] == pytest.approx(r[0], rel=0.02, abs=1e-6)


def test_held_out_errors_exceed_the_residuals() -> None:
    subject = solved(make_scene(6, count=12))
    lin = linearise(subject.problem, subject.at)
    P = weights(lin, subject.noise)
    inside, _ = pose_distances(subject.problem.target_poses(subject.at.X), subject.at.W[0])
    outside = held_out(lin, P)
    assert sorted(outside.rows) == list(range(12))
    assert outside.t.mean() > inside.mean()


def test_spread_of_a_perfect_arm_equals_its_noise_floor() -> None:
    within, across = [], []
    for seed in range(12):
        scene = make_scene(seed, count=60, groups=5, flange_t=0.0, flange_r=0.0)
        subject = solved(scene, {"sigma_px": 0.2, "sigma_flange_t": 0.0, "sigma_flange_r": 0.0})
        lin = linearise(subject.problem, subject.at)
        P = weights(lin, subject.noise)
        found = placements(subject.problem, subject.at, P, 0.04 * subject.problem.cov_px)
        w, a = spread_within(found), spread_across(found)
        assert w is not None
        assert a is not None
        within.append(((w.t_norm / w.floor_t) ** 2, (w.r / w.floor_r) ** 2))
        across.append(((a.t_norm / a.floor_t) ** 2, (a.r / a.floor_r) ** 2))
    assert np.sqrt(np.mean(within, axis=0)) == pytest.approx([1.0, 1.0], abs=0.15)
    assert np.sqrt(np.mean(across, axis=0)) == pytest.approx([1.0, 1.0], abs=0.35)


def test_spread_of_a_poor_arm_stands_out_of_the_floor() -> None:
    noise = {"sigma_px": 0.2, "sigma_flange_t": 1e-3, "sigma_flange_r": 3e-3}
    subject = solved(make_scene(1, count=60, groups=5, flange_t=1e-3, flange_r=3e-3), noise)
    lin = linearise(subject.problem, subject.at)
    perfect = subject.noise.sigma["sigma_px"] ** 2 * subject.problem.cov_px
    found = spread_within(placements(subject.problem, subject.at, weights(lin, subject.noise), perfect))
    assert found is not None
    assert found.resolved


def test_a_placement_of_two_poses_has_no_triples() -> None:
    subject = solved(make_scene(1, count=8, groups=4))
    P = weights(linearise(subject.problem, subject.at), subject.noise)
    assert placements(subject.problem, subject.at, P, subject.problem.cov_px) == []


def test_estimates_survive_moving() -> None:
    at = Estimate(np.eye(4), np.eye(4)[None])
    assert np.allclose(at.moved(np.zeros((2, 6))).W, at.W)


@pytest.mark.parametrize("setup", ["eye-in-hand", "eye-to-hand"])
def test_the_closed_form_is_exact_with_perfect_data(setup: str) -> None:
    perfect = make_scene(setup=setup, count=12, groups=2, px=0.0, flange_t=0.0, flange_r=0.0)
    assert np.linalg.norm(error_of(closed_form_X(prepare(perfect.measurements(), CAMERA)))) < 1e-7


def test_the_closed_form_is_some_pose_where_each_target_was_seen_once() -> None:
    subject = closed_form_X(prepare(make_scene(count=4, groups=4).measurements(), CAMERA))
    assert subject[:3, :3].T @ subject[:3, :3] == pytest.approx(np.eye(3), abs=1e-12)
