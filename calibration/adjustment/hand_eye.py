"""Hand-eye with everything in it that is never as its model: arm, gears, lens and printed target.

The images' poses are the observations (:mod:`calibration.hand_eye.problem`). What differs from the model
moves them or the flange; each has a prior, and the images say more of lens and target by themselves. The
covariance of X then holds where the model is wrong in these ways, and its parts say where it comes from.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from calibration.adjustment.arm_terms import (
    ArmPrior,
    ArmTerms,
    gears_and_sag,
    geometry,
    reference_joints,
    without_gauge,
)
from calibration.adjustment.components import Components, estimated
from calibration.adjustment.equations import Equations, Observations, Prior, inverse_spd
from calibration.adjustment.lens_terms import (
    LENS,
    TARGET,
    ImageTerms,
    LensPrior,
    TargetPrior,
    TargetShape,
    image_terms,
    moved_camera,
    target_shape,
)
from calibration.hand_eye import se3
from calibration.hand_eye.noise import MOST, shapes
from calibration.hand_eye.normal import Linearised, linearise
from calibration.hand_eye.pnp import refine_poses
from calibration.hand_eye.problem import Estimate, Problem, flange_adjoint
from calibration.hand_eye.solution import Measurements, Solution
from calibration.hand_eye.views import CornerSet, undistort
from calibration.kinematics.parametric import ParametricArm
from cell.devices import Intrinsics
from cell.poses import Array

GEOMETRY, GEARS, LENS_BLOCK, TARGET_BLOCK = "geometry", "gears", "lens", "target"
_ROUNDS = 4  # images solved again with the lens and the target found
_STEPS = 4
_SETTLED = 0.01  # of a standard deviation of X
_CHANCE = 1e-3
_LINEAR = 0.3  # of these the images' poses follow a change of lens and target linearly enough
_LINEAR_SIGMA = np.concatenate([LensPrior().sigma(), TargetPrior().sigma()])


@dataclass(frozen=True)
class ArmKnown:
    """The arm of a capture: its adjustable model, joints ``Q`` (n, 6) rad, limits (6, 2) rad, and prior.

    ``scale_free``: how good the arm is follows from the data, the prior says the proportions.
    """

    model: ParametricArm
    Q: Array
    limits: Array
    prior: ArmPrior = field(default_factory=ArmPrior)
    scale_free: bool = True


@dataclass(frozen=True)
class Adjusted:
    """``X`` (4, 4) and ``cov`` (6, 6) in its own frame, target poses ``W`` (g, 4, 4), and the rest.

    ``numbers`` (p,) and ``cov_numbers`` (p, p): what was found of the unknowns ``names``. ``budget``: the
    variances of X, (6,), by block; they add up. ``excess`` is the square of the factor by which the residuals
    exceed the noise levels; the covariances carry it. ``components`` are noise levels and scales, ``camera``
    is the lens that was found, ``problem`` the used observations as that lens, target and arm have them.
    """

    X: Array
    cov: Array
    W: Array
    cov_W: Array
    names: tuple[str, ...]
    numbers: Array
    cov_numbers: Array
    blocks: Mapping[str, slice]
    budget: Mapping[str, Array]
    excess: float
    components: Components
    camera: Intrinsics
    problem: Problem

    @property
    def sigma(self) -> Array:
        """(p,) standard deviations of the numbers."""
        return np.asarray(np.sqrt(np.diag(self.cov_numbers)))


def adjust(
    measured: Measurements,
    solution: Solution,
    camera: Intrinsics,
    arm: ArmKnown | None,
    lens: LensPrior | None = None,
    target: TargetPrior | None = None,
) -> Adjusted:
    """From the observations that ``solution`` uses, and from where it is. Each of them needs a view.

    ``camera`` is the one that ``solution`` was made with, and ``lens`` says how well it is known. Without
    ``arm`` the flange's poses are taken as an exact arm has them, but for their noise.
    """
    rows = np.flatnonzero(solution.used)
    problem = solution.problem.take(solution.used)
    views = [v for i in rows.tolist() if (v := measured.views[i]) is not None]
    views = _numbered_alike(views, problem.C, camera, measured.motions)
    shape = target_shape(views)
    cell = _cell(problem, rows, arm, lens or LensPrior(), target or TargetPrior())
    free = (GEOMETRY, GEARS) if arm is not None and arm.scale_free else ()
    state = _State(
        problem,
        solution.at,
        np.zeros(len(cell.names)),
        np.zeros(len(cell.names)),
        Components(
            {k: v for k, v in solution.noise.sigma.items() if "pose" not in k},
            dict.fromkeys(free, 1.0),
            frozenset([*solution.noise.estimated, *free]),
            MOST,
        ),
    )
    now, seen = camera, views
    for _ in range(_ROUNDS):
        state, eq = _solved(cell, state, image_terms(seen, state.problem.C, now, shape))
        away = (state.numbers - state.base)[cell.images]
        if np.all(np.abs(away) < _LINEAR * _LINEAR_SIGMA):
            break
        now = moved_camera(camera, state.numbers[cell.blocks[LENS_BLOCK]])
        seen = _printed(views, shape, state.numbers[cell.blocks[TARGET_BLOCK]])
        poses = refine_poses(seen, now, state.problem.C)
        solved = replace(state.problem, C=poses.C, cov_px=poses.cov, sse=poses.sse)
        state = replace(state, problem=solved, base=state.numbers)
    cov = eq.covariance
    images = image_terms(seen, state.problem.C, now, shape)
    excess = _excess(cell, state, images)
    return Adjusted(
        X=state.at.X,
        cov=excess * cov[:6, :6],
        W=state.at.W,
        cov_W=excess * eq.local_covariance(),
        excess=excess,
        names=cell.names,
        numbers=state.numbers,
        cov_numbers=excess * cov[6:, 6:],
        blocks=cell.blocks,
        budget={name: excess * part for name, part in _budget(eq, cell.blocks).items()},
        components=state.components,
        camera=moved_camera(camera, state.numbers[cell.blocks[LENS_BLOCK]]),
        problem=_moved(cell, state, images.moves),
    )


@dataclass(frozen=True)
class _Cell:
    """The unknowns beside X: ``names`` (p,), ``blocks``, ``prior`` with X before them, and what they move.

    ``flange`` (n, 6, a): twists of the flange for the a numbers of the arm, which come first.
    """

    names: tuple[str, ...]
    blocks: dict[str, slice]
    prior: Prior
    flange: Array

    @property
    def images(self) -> slice:
        """The numbers that images see: lens and target."""
        return slice(self.flange.shape[2], len(self.names))

    @property
    def arm(self) -> slice:
        return slice(0, self.flange.shape[2])


@dataclass(frozen=True)
class _State:
    """Where the adjustment is; the images of ``problem`` were solved with the numbers ``base``."""

    problem: Problem
    at: Estimate
    numbers: Array
    base: Array
    components: Components


def _cell(
    problem: Problem, rows: NDArray[np.int64], arm: ArmKnown | None, lens: LensPrior, target: TargetPrior
) -> _Cell:
    terms = {} if arm is None else arm_terms(arm, arm.Q[rows])
    parts = [(name, t.names, t.sigma) for name, t in terms.items()]
    parts += [(LENS_BLOCK, LENS, lens.sigma()), (TARGET_BLOCK, TARGET, target.sigma())]
    names: list[str] = []
    blocks = {}
    for block, own, _ in parts:
        blocks[block] = slice(len(names), len(names) + len(own))
        names += own
    prior = Prior(
        np.zeros(6 + len(names)),
        np.concatenate([np.full(6, np.inf), *(sigma for _, _, sigma in parts)]),
        {name: slice(6 + s.start, 6 + s.stop) for name, s in blocks.items()},
    )
    flange = np.concatenate([np.zeros((problem.n, 6, 0)), *(t.columns for t in terms.values())], axis=2)
    return _Cell(tuple(names), blocks, prior, flange)


def arm_terms(arm: ArmKnown, Q: Array) -> dict[str, ArmTerms]:
    """The terms of the arm's blocks at joints ``Q`` (n, 6), without what moves base or flange as a whole."""
    over, chain = reference_joints(arm.limits), arm.model.base
    flange, over_flange = chain.flange(Q), chain.flange(over)
    return {
        GEOMETRY: without_gauge(
            geometry(arm.model, Q, arm.prior), flange, geometry(arm.model, over, arm.prior), over_flange
        ),
        GEARS: without_gauge(
            gears_and_sag(chain, Q, arm.prior), flange, gears_and_sag(chain, over, arm.prior), over_flange
        ),
    }


def _solved(cell: _Cell, state: _State, images: ImageTerms) -> tuple[_State, Equations]:
    """X, target poses, numbers and their scales, with the images as they were solved."""
    for k in range(_STEPS):
        lin = linearise(_moved(cell, state, images.moves), state.at)
        obs = _observations(cell, state, images, lin)
        x0 = np.concatenate([np.zeros(6), state.numbers])
        components = state.components if k > 1 else estimated(obs, cell.prior, x0, state.components)
        eq = components.equations(obs, cell.prior, x0)
        x, w = eq.step()
        state = replace(
            state,
            at=state.at.moved(np.concatenate([x[None, :6], w])),
            numbers=state.numbers + x[6:],
            components=components,
        )
        if k > 0 and np.all(np.abs(x[:6]) < _SETTLED * np.sqrt(np.diag(eq.covariance)[:6])):
            break
    return state, eq


def _moved(cell: _Cell, state: _State, moves: Array) -> Problem:
    """The problem as it is with the numbers of ``state``; ``moves`` (n, 6, c) are those of the images."""
    problem, numbers = state.problem, state.numbers
    C = se3.exp(moves @ (numbers - state.base)[cell.images]) @ problem.C
    twist = cell.flange @ numbers[cell.arm]
    if problem.setup == "eye-in-hand":
        return replace(problem, C=C, G=se3.exp(-twist) @ problem.G)
    return replace(problem, C=C, G=problem.G @ se3.exp(twist))


def _observations(cell: _Cell, state: _State, images: ImageTerms, lin: Linearised) -> Observations:
    """The linearised problem ``lin`` with the derivatives by all numbers.

    ``r = log(C C_predicted^-1)``: a motion s of the image's pose on the left adds ``Jl^-1(r) s``, a motion t
    of the predicted one on the left takes ``Jr^-1(r) t`` away.
    """
    n, count = lin.problem.n, len(cell.names)
    of_global = np.zeros((n, 6, 6 + count))
    of_global[:, :, :6] = lin.J[:, :, :6]
    sign = 1.0 if lin.problem.setup == "eye-in-hand" else -1.0
    carried = se3.right_jacobian_inverse(lin.r) @ flange_adjoint(lin.problem, lin.at, lin.predicted)
    after = slice(6 + cell.images.start, None)
    of_global[:, :, 6 : after.start] = sign * carried @ cell.flange
    of_global[:, :, after] = se3.right_jacobian_inverse(-lin.r) @ images.moves
    away = (state.numbers - state.base)[cell.images]
    info, pull = np.zeros((n, 6 + count, 6 + count)), np.zeros((n, 6 + count))
    info[:, after, after] = images.info
    pull[:, after] = images.pull + images.info @ away
    return Observations(
        r=lin.r,
        of_global=of_global,
        of_local=lin.J[:, :, 6:],
        group=lin.problem.group,
        parts=shapes(lin, tuple(state.components.sigma)),
        info=info,
        pull=pull,
        sse=lin.problem.sse + (2.0 * images.pull + images.info @ away) @ away,
        dof=lin.problem.dof,
    )


def _excess(cell: _Cell, state: _State, images: ImageTerms) -> float:
    """By which the squared residuals exceed what the noise explains, one where they do not beyond chance."""
    lin = linearise(_moved(cell, state, images.moves), state.at)
    obs = _observations(cell, state, images, lin)
    weight = inverse_spd(state.components.variances(obs.parts))
    squared = float(np.einsum("ni,nij,nj->", lin.r, weight, lin.r))
    left = 6 * lin.problem.n - 6 - 6 * lin.problem.groups
    return squared / left if left > 0 and squared > chdtri(left, _CHANCE) else 1.0


def _numbered_alike(
    views: Sequence[CornerSet], C: Array, camera: Intrinsics, motions: Array
) -> list[CornerSet]:
    """Views with their points as the poses ``C`` (n, 4, 4) have them: ``motions`` turn a target onto itself,
    and an image may have numbered it in any of these ways."""
    if len(motions) == 1:
        return list(views)
    out = []
    for view, pose in zip(views, C, strict=True):
        turned = view.points @ np.swapaxes(motions[:, :3, :3], 1, 2) + motions[:, None, :3, 3]
        p = turned @ pose[:3, :3].T + pose[:3, 3]
        off = p[..., :2] / p[..., 2:] - undistort(view.corners, camera)
        out.append(replace(view, points=turned[int(np.argmin(np.sum(off**2, axis=(1, 2))))]))
    return out


def _printed(views: Sequence[CornerSet], shape: TargetShape, numbers: Array) -> list[CornerSet]:
    return [replace(view, points=shape.moved(view.points, numbers)) for view in views]


def _budget(eq: Equations, blocks: Mapping[str, slice]) -> dict[str, Array]:
    """Variance of X (6,) by block: what goes away when the blocks become known one after the other.

    What is left then is noise; the parts add up to the whole.
    """
    known = np.zeros(len(eq.N), dtype=bool)
    left = np.diag(eq.covariance)[:6]
    budget = {}
    for name, part in blocks.items():
        known[6 + part.start : 6 + part.stop] = True
        keep = np.flatnonzero(~known)
        now = np.diag(np.linalg.inv(eq.N[np.ix_(keep, keep)]))[:6]
        budget[name] = left - now
        left = now
    budget["noise"] = left
    return budget
