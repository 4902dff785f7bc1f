"""Hand-eye with everything in it that is never as its model: arm, gears, lens and printed target.

The images' poses are the observations (:mod:`calibration.hand_eye.problem`). What differs from the model
moves them or the flange; each has a prior, and the images say more of lens and target by themselves. The
covariance of X then holds where the model is wrong in these ways, and its parts say where it comes from.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calibration.adjustment.arm_about import ArmAbout
from calibration.adjustment.components import Components, estimated, with_mean_scales
from calibration.adjustment.equations import Equations, Observations
from calibration.adjustment.jackknife import Checked, checked, jackknife
from calibration.adjustment.lens_terms import (
    ImageTerms,
    LensPrior,
    TargetPrior,
    TargetShape,
    image_terms,
    moved_camera,
    target_shape,
)
from calibration.adjustment.shared_errors import PLACE, SharedErrors
from calibration.adjustment.twists import StoredTwists
from calibration.adjustment.unknowns import (
    LENS_BLOCK,
    NOISE,
    TARGET_BLOCK,
    AdjustedState,
    ArmKnown,
    Unknowns,
    budget,
    free_scales,
    moved_problem,
    observations,
    predicted_poses,
    unknowns,
    with_flange_moved,
)
from calibration.hand_eye.noise import inverse_spd
from calibration.hand_eye.normal import linearise
from calibration.hand_eye.pnp import refine_poses
from calibration.hand_eye.problem import Problem
from calibration.hand_eye.solution import Measurements, Solution
from calibration.hand_eye.solution import excess_of as excess_over
from calibration.hand_eye.views import CornerSet, blocks, ideal_corners
from cell.devices import Intrinsics
from cell.poses import Array

_ROUNDS = 4  # images solved again with the lens and the target found
_STEPS = 4
_SETTLED = 0.01  # of a standard deviation of X
_NONLINEAR = 0.1  # of it: the products of the arm's numbers move X by less, or are in the flange's poses
_LINEAR = 0.3  # of these the images' poses follow a change of lens and target linearly enough
_LINEAR_SIGMA = np.concatenate([LensPrior().sigma(), TargetPrior().sigma()])


@dataclass(frozen=True)
class Adjusted:
    """``X`` (4, 4) and ``cov`` (6, 6) in its own frame, target poses ``W`` (g, 4, 4), and the rest.

    ``numbers`` (p,) and ``cov_numbers`` (p, p): what was found of the unknowns ``names``. ``budget``: the
    variances of X, (6,), by block; they add up. ``excess`` is the square of the factor by which the residuals
    exceed the noise levels; the covariances carry it; ``cross`` (6, p) is the covariance of X with the
    numbers, ``cross_W`` (g, 6, 6 + p) that of each W with X and the numbers. ``components`` are the noise
    levels and scales that all of this is the solution with; ``camera`` is the lens that was found, ``shape``
    what the bow of the target is measured from, ``problem`` the used observations as that lens, target and
    arm have them. ``by_leaving_out`` is what ``cov`` was checked against; what it added is in the budget's
    noise. ``arm_at`` (a,): the numbers of the arm about which its flange was taken as linear, zero where that
    holds about the arm as it is configured. ``settled``: images and flange follow the numbers linearly from
    where they were solved last.
    """

    X: Array
    cov: Array
    W: Array
    cov_W: Array
    names: tuple[str, ...]
    numbers: Array
    cov_numbers: Array
    cross: Array
    cross_W: Array
    blocks: Mapping[str, slice]
    budget: Mapping[str, Array]
    excess: float
    arm_at: Array
    components: Components
    camera: Intrinsics
    shape: TargetShape
    problem: Problem
    by_leaving_out: Checked
    settled: bool

    @property
    def sigma(self) -> Array:
        """(p,) standard deviations of the numbers."""
        return np.asarray(np.sqrt(np.diag(self.cov_numbers)))

    @property
    def cov_with_lens(self) -> Array:
        """(14, 14) of X and the numbers ``LENS`` together."""
        lens = self.blocks[LENS_BLOCK]
        cross = self.cross[:, lens]
        return np.block([[self.cov, cross], [cross.T, self.cov_numbers[lens, lens]]])


def adjust(
    measured: Measurements,
    solution: Solution,
    camera: Intrinsics,
    arm: ArmKnown | SharedErrors | None,
    lens: LensPrior | None = None,
    target: TargetPrior | None = None,
) -> Adjusted:
    """From the observations that ``solution`` uses, and from where it is. Each of them needs a view.

    ``camera`` is the one that ``solution`` was made with, and ``lens`` says how well it is known. Without
    ``arm`` the flange's poses are taken as an exact arm has them, but for their noise. Of an arm whose joints
    are not known there are :class:`SharedErrors`.
    """
    rows = np.flatnonzero(solution.used)
    problem = solution.problem.take(solution.used)
    views = [v for i in rows.tolist() if (v := measured.views[i]) is not None]
    views = numbered_alike(views, problem.C, camera, measured.motions)
    shape = target_shape(views)
    of = unknowns(problem, rows, arm, lens or LensPrior(), target or TargetPrior())
    free = free_scales(arm)
    state = AdjustedState(
        problem,
        solution.at,
        np.zeros(len(of.names)),
        np.zeros(len(of.names)),
        Components(
            {k: v for k, v in solution.noise.sigma.items() if "pose" not in k},
            dict.fromkeys(free, 1.0),
            frozenset([*solution.noise.estimated, *free]),
            solution.noise.most,
        ),
    )
    now, seen = camera, views
    for again in range(_ROUNDS):
        images = image_terms(seen, state.problem.C, now, shape, predicted_poses(of, state))
        state, eq = solved(of, state, images, estimates=1 if again else 2)
        base = state.numbers.copy()
        away = (base - state.base)[of.images]
        images_follow = bool(np.all(np.abs(away) < _LINEAR * _LINEAR_SIGMA))
        sigma = np.sqrt(np.diag(eq.covariance)[:6])
        anew = None
        if isinstance(arm, ArmKnown):
            anew = _relinearised(of, state, images, arm, problem, rows, sigma)
        settled = images_follow and anew is None
        if settled or again == _ROUNDS - 1:
            break
        if anew is None:
            base[of.arm] = state.base[of.arm]
        else:
            of = replace(of, flange=StoredTwists(anew.columns))
            state = replace(state, problem=anew.problem)
        if images_follow:
            base[of.images] = state.base[of.images]
        else:
            now = moved_camera(camera, state.numbers[of.blocks[LENS_BLOCK]])
            seen = _printed(views, shape, state.numbers[of.blocks[TARGET_BLOCK]])
            poses = refine_poses(seen, now, state.problem.C)
            again_seen = replace(state.problem, C=poses.C, cov_px=poses.cov, sse=poses.sse)
            state = replace(state, problem=again_seen)
        state = replace(state, base=base)
    obs, x0 = observed(of, state, images)
    if isinstance(arm, ArmKnown) and free:  # few poses tell its scales to some ten per cent
        components = with_mean_scales(obs, of.prior, x0, state.components)
        state, eq = solved(of, replace(state, components=components), images, estimates=0)
        obs, x0 = observed(of, state, images)
    excess = excess_of(obs, state.components)
    by_jackknife = jackknife(obs, state.components, state.components.equations(obs, of.prior, x0), 6)
    cov = eq.covariance
    by_leaving_out = checked(cov[:6, :6], by_jackknife, excess)
    causes = {name: excess * part for name, part in budget(eq, of.blocks).items()}
    causes[NOISE] = causes[NOISE] + np.diag(by_leaving_out.added)
    return Adjusted(
        X=state.at.X,
        cov=by_leaving_out.cov,
        W=state.at.W,
        cov_W=excess * eq.local_covariance(),
        excess=excess,
        names=of.names,
        numbers=state.numbers,
        cov_numbers=excess * cov[6:, 6:],
        cross=excess * cov[:6, 6:],
        cross_W=excess * eq.local_cross(),
        blocks=of.blocks,
        budget=causes,
        arm_at=state.base[of.arm],
        components=state.components,
        camera=moved_camera(camera, state.numbers[of.blocks[LENS_BLOCK]]),
        shape=shape,
        problem=moved_problem(of, state, images.moves),
        by_leaving_out=by_leaving_out,
        settled=settled,
    )


@dataclass(frozen=True)
class _Relinearised:
    """``problem`` with its flange as the arm with its numbers has it, and the ``columns`` (n, 6, a) there."""

    problem: Problem
    columns: Array


def _relinearised(
    of: Unknowns,
    state: AdjustedState,
    images: ImageTerms,
    arm: ArmKnown,
    given: Problem,
    rows: NDArray[np.int64],
    sigma: Array,
) -> _Relinearised | None:
    """None where X would hardly move if the flange of ``given`` had all that the numbers do to it.

    ``sigma`` (6,) are the standard deviations of X.
    """
    if _products(arm, state.numbers[of.arm]) < _NONLINEAR * float(sigma.min()):
        return None
    about = ArmAbout(arm, state.numbers[of.arm])
    Q = arm.Q[rows]
    moved = with_flange_moved(replace(state.problem, G=given.G), about.motion(Q))
    base = state.base.copy()
    base[of.arm] = state.numbers[of.arm]
    there = replace(state, problem=moved, base=base)
    obs = observations(of, there, images, linearise(moved_problem(of, there, images.moves), there.at))
    eq = state.components.equations(obs, of.prior, np.concatenate([np.zeros(6), state.numbers]))
    x, _ = eq.step()
    if np.all(np.abs(x[:6]) < _NONLINEAR * sigma):
        return None
    return _Relinearised(moved, about.columns(Q))


def _products(arm: ArmKnown, numbers: Array) -> float:
    """About how far, in rad and in m at 1 m, the products of the arm's numbers move its flange."""
    kinds = np.array([*arm.model.kinds, *["angle"] * (len(numbers) - len(arm.model.kinds))])
    return float(np.sum(numbers[kinds != "length"] ** 2))


def as_found(found: Adjusted, measured: Measurements, solution: Solution) -> tuple[Measurements, Problem]:
    """All observations, also those that ``solution`` does not use, with lens, target and arm as found.

    The flange of an observation that is not used stays where it was given; so do all where errors that
    neighbouring poses share were found: at poses that were not visited nothing is known of them.
    """
    problem = solution.problem
    seen = [i for i, v in enumerate(measured.views) if v is not None]
    views = [v for v in measured.views if v is not None]
    views = numbered_alike(views, problem.C[seen], found.camera, measured.motions)
    views = _printed(views, found.shape, found.numbers[found.blocks[TARGET_BLOCK]])
    G, C, cov, sse = problem.G.copy(), problem.C.copy(), problem.cov_px.copy(), problem.sse.copy()
    poses = refine_poses(views, found.camera, C[seen])
    C[seen], cov[seen], sse[seen] = poses.C, poses.cov, poses.sse
    used, own = solution.used, found.problem
    if PLACE not in found.blocks:
        G[used] = own.G
    C[used], cov[used], sse[used] = own.C, own.cov_px, own.sse
    printed: list[CornerSet | None] = list(measured.views)
    for i, view in zip(seen, views, strict=True):
        printed[i] = view
    return replace(measured, views=printed), replace(problem, G=G, C=C, cov_px=cov, sse=sse)


@dataclass(frozen=True)
class LaterPoses:
    """``C`` (n, 4, 4) T_camera_target of images that nothing was found from. ``cov`` (n, 6, 6) is by their
    corners alone; ``moves`` (n, 6, c) is by lens and target, whose ``common`` (c, c) is one error of all.
    Perturbations are on the left."""

    C: Array
    cov: Array
    moves: Array
    common: Array


def later_poses(found: Adjusted, views: Sequence[CornerSet], near: Array, motions: Array) -> LaterPoses:
    """With lens and target as they were found, for targets that are near ``near`` (n, 4, 4)."""
    views = numbered_alike(views, near, found.camera, motions)
    views = _printed(views, found.shape, found.numbers[found.blocks[TARGET_BLOCK]])
    poses = refine_poses(views, found.camera, near)
    images = slice(found.blocks[LENS_BLOCK].start, found.blocks[TARGET_BLOCK].stop)
    moves = image_terms(views, poses.C, found.camera, found.shape).moves
    variance = found.excess * found.components.sigma["sigma_px"] ** 2
    return LaterPoses(poses.C, variance * poses.cov, moves, found.cov_numbers[images, images])


def solved(
    of: Unknowns, state: AdjustedState, images: ImageTerms, estimates: int
) -> tuple[AdjustedState, Equations]:
    """X, target poses, numbers and their scales, with the images as they were solved; the scales are
    estimated in the first ``estimates`` steps."""
    for k in range(_STEPS):
        state, eq, x = _step(of, state, images, estimate=k < estimates)
        if k > 0 and np.all(np.abs(x) < _SETTLED * np.sqrt(np.diag(eq.covariance)[:6])):
            break
    return state, eq


def _step(
    of: Unknowns, state: AdjustedState, images: ImageTerms, estimate: bool
) -> tuple[AdjustedState, Equations, Array]:
    """One step of all unknowns, and by how much X moved, (6,)."""
    lin = linearise(moved_problem(of, state, images.moves), state.at)
    obs = observations(of, state, images, lin)
    x0 = np.concatenate([np.zeros(6), state.numbers])
    components = estimated(obs, of.prior, x0, state.components) if estimate else state.components
    eq = components.equations(obs, of.prior, x0)
    x, w = eq.step()
    moved = state.at.moved(np.concatenate([x[None, :6], w]))
    return replace(state, at=moved, numbers=state.numbers + x[6:], components=components), eq, x[:6]


def observed(of: Unknowns, state: AdjustedState, images: ImageTerms) -> tuple[Observations, Array]:
    """The observations at ``state``, and where the global unknowns are."""
    obs = observations(of, state, images, linearise(moved_problem(of, state, images.moves), state.at))
    return obs, np.concatenate([np.zeros(6), state.numbers])


def excess_of(obs: Observations, components: Components) -> float:
    """By which the squared residuals exceed what the noise explains, one where they do not beyond chance."""
    return excess_over(obs.r, inverse_spd(components.variances(obs.parts)), obs.groups)


def numbered_alike(
    views: Sequence[CornerSet], C: Array, camera: Intrinsics, motions: Array
) -> list[CornerSet]:
    """Views with their points as the poses ``C`` (n, 4, 4) have them: ``motions`` turn a target onto itself,
    and an image may have numbered it in any of these ways."""
    if len(motions) == 1:
        return list(views)
    out = []
    for view, pose, ideal in zip(views, C, ideal_corners(views, camera), strict=True):
        turned = view.points @ np.swapaxes(motions[:, :3, :3], 1, 2) + motions[:, None, :3, 3]
        p = turned @ pose[:3, :3].T + pose[:3, 3]
        off = p[..., :2] / p[..., 2:] - ideal
        out.append(replace(view, points=turned[int(np.argmin(np.sum(off**2, axis=(1, 2))))]))
    return out


def _printed(views: Sequence[CornerSet], shape: TargetShape, numbers: Array) -> list[CornerSet]:
    """Views of the target as it is printed; those that share their points share them again."""
    printed: dict[int, Array] = {}
    for rows in blocks(len(views)):
        new = {id(v.points): v.points for v in views[rows] if id(v.points) not in printed}
        if new:
            points = shape.moved(np.concatenate([*new.values()]), numbers)
            ends = np.cumsum([len(p) for p in new.values()])[:-1]
            printed |= zip(new, np.split(points, ends), strict=True)
    return [CornerSet(printed[id(v.points)], v.corners, v.count, v.start) for v in views]
