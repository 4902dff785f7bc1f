"""The unknowns beside the camera's pose in a hand-eye adjustment, and what the observations say of them."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from calibration.adjustment.arm_terms import (
    ArmPrior,
    ArmTerms,
    common_motion,
    gears_and_sag,
    geometry,
    joints_to_average,
    without_gauge,
)
from calibration.adjustment.components import Components
from calibration.adjustment.equations import Equations, Observations, Prior
from calibration.adjustment.lens_terms import LENS, TARGET, ImageTerms, LensPrior, TargetPrior
from calibration.adjustment.shared_errors import ATTITUDE, PLACE, SharedErrors
from calibration.adjustment.twists import StoredTwists, Twists
from calibration.hand_eye import se3
from calibration.hand_eye.noise import shapes
from calibration.hand_eye.normal import Linearised
from calibration.hand_eye.problem import Estimate, Problem, flange_adjoint, residuals
from calibration.kinematics.parametric import ParametricArm
from cell.poses import Array

GEOMETRY, GEARS, LENS_BLOCK, TARGET_BLOCK = "geometry", "gears", "lens", "target"
NOISE = "noise"  # in a budget: what no block explains
_MANY = 1000  # observations of which derivatives are not kept; of so many they take 6 MB


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
class Unknowns:
    """The unknowns beside X: ``names`` (p,), ``blocks``, ``prior`` with X before them, and what they move.

    ``flange``: twists of the flange for the a numbers of the arm, which come first.
    """

    names: tuple[str, ...]
    blocks: dict[str, slice]
    prior: Prior
    flange: Twists

    @property
    def images(self) -> slice:
        """The numbers that images see: lens and target."""
        return slice(self.flange.numbers, len(self.names))

    @property
    def arm(self) -> slice:
        return slice(0, self.flange.numbers)


@dataclass(frozen=True)
class AdjustedState:
    """Where the adjustment is; images and flange of ``problem`` are those of the numbers ``base``."""

    problem: Problem
    at: Estimate
    numbers: Array
    base: Array
    components: Components


def unknowns(
    problem: Problem,
    rows: NDArray[np.int64],
    arm: ArmKnown | SharedErrors | None,
    lens: LensPrior | None,
    target: TargetPrior | None,
) -> Unknowns:
    """Of ``problem``, whose observations have the joints ``rows`` of ``arm``; lens and target of images."""
    parts: list[tuple[str, tuple[str, ...], Array]] = []
    flange: Twists
    if isinstance(arm, SharedErrors):
        parts += [(name, *of) for name, of in arm.blocks().items()]
        flange = arm.twists(problem.flange)
    else:
        terms = {} if arm is None else arm_terms(arm, arm.Q[rows])
        parts += [(name, t.names, t.sigma) for name, t in terms.items()]
        columns = [np.zeros((problem.n, 6, 0)), *(t.columns for t in terms.values())]
        flange = StoredTwists(np.concatenate(columns, axis=2))
    if lens is not None:
        parts.append((LENS_BLOCK, LENS, lens.sigma()))
    if target is not None:
        parts.append((TARGET_BLOCK, TARGET, target.sigma()))
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
    return Unknowns(tuple(names), blocks, prior, flange)


def free_scales(arm: ArmKnown | SharedErrors | None) -> tuple[str, ...]:
    """Blocks of ``arm`` whose prior's scale follows from the data."""
    if isinstance(arm, SharedErrors):
        return (PLACE, ATTITUDE)
    return (GEOMETRY, GEARS) if arm is not None and arm.scale_free else ()


def arm_terms(arm: ArmKnown, Q: Array) -> dict[str, ArmTerms]:
    """The terms of the arm's blocks at joints ``Q`` (n, 6), without what moves base or flange as a whole."""
    flange = arm.model.base.flange(Q)
    gauges = _gauges(arm.model, tuple((low, high) for low, high in arm.limits.tolist()))
    terms = _arm_blocks(arm.model, Q, arm.prior)
    return {block: without_gauge(of, flange, gauges[block]) for block, of in terms.items()}


def _arm_blocks(model: ParametricArm, Q: Array, prior: ArmPrior) -> dict[str, ArmTerms]:
    return {GEOMETRY: geometry(model, Q, prior), GEARS: gears_and_sag(model.base, Q, prior)}


@lru_cache(maxsize=8)
def _gauges(model: ParametricArm, limits: tuple[tuple[float, float], ...]) -> dict[str, Array]:
    """The motions of base and flange in each block, over all joints: the same for all that one arm does."""
    over = joints_to_average(np.array(limits))
    flange = model.base.flange(over)
    return {
        block: common_motion(of.columns, flange) for block, of in _arm_blocks(model, over, ArmPrior()).items()
    }


def predicted_poses(of: Unknowns, state: AdjustedState) -> Array:
    """T_camera_target (n, 4, 4) where arm, camera and targets have it, whatever its image shows."""
    still = np.zeros((state.problem.n, 6, of.images.stop - of.images.start))
    return residuals(moved_problem(of, state, still), state.at)[1]


def moved_problem(of: Unknowns, state: AdjustedState, moves: Array) -> Problem:
    """The problem as it is with the numbers of ``state``; ``moves`` (n, 6, c) are those of the images."""
    problem, numbers = state.problem, state.numbers
    C = se3.exp(moves @ (numbers - state.base)[of.images]) @ problem.C
    twist = of.flange.moved((numbers - state.base)[of.arm])
    return with_flange_moved(replace(problem, C=C), se3.exp(twist), se3.exp(-twist))


def with_flange_moved(problem: Problem, motion: Array, back: Array | None = None) -> Problem:
    """``problem`` with its flange moved by ``motion`` (n, 4, 4) in its own frame; ``back`` undoes that."""
    if problem.setup == "eye-to-hand":
        return replace(problem, G=problem.G @ motion)
    return replace(problem, G=(se3.inverse(motion) if back is None else back) @ problem.G)


@dataclass(frozen=True)
class _Derivatives:
    """(n, 6, m) of the residuals by X, the arm's numbers and those of the images, made when they are wanted.

    ``by_X`` (n, 6, 6); ``carried`` (n, 6, 6) takes a motion of the flange, ``seen`` (n, 6, 6) one of an
    image's pose, which the c numbers of the images move by ``moves`` (n, 6, c), to the residual.
    """

    by_X: Array
    carried: Array
    flange: Twists
    seen: Array
    moves: Array

    @property
    def shape(self) -> tuple[int, int, int]:
        return len(self.by_X), 6, 6 + self.flange.numbers + self.moves.shape[2]

    def __getitem__(self, rows: slice) -> Array:
        by_X, after = self.by_X[rows], 6 + self.flange.numbers
        out = np.empty((len(by_X), *self.shape[1:]))
        out[..., :6] = by_X
        self.flange.carried(self.carried[rows], rows, out[..., 6:after])
        np.matmul(self.seen[rows], self.moves[rows], out=out[..., after:])
        return out


def observations(of: Unknowns, state: AdjustedState, images: ImageTerms, lin: Linearised) -> Observations:
    """The linearised problem ``lin`` with the derivatives by all numbers.

    ``r = log(C C_predicted^-1)``: a motion s of the image's pose on the left adds ``Jl^-1(r) s``, a motion t
    of the predicted one on the left takes ``Jr^-1(r) t`` away.
    """
    n, count = lin.problem.n, len(of.names)
    sign = 1.0 if lin.problem.setup == "eye-in-hand" else -1.0
    derivatives = _Derivatives(
        lin.J[:, :, :6],
        sign * se3.right_jacobian_inverse(lin.r) @ flange_adjoint(lin.problem, lin.at, lin.predicted),
        of.flange,
        se3.right_jacobian_inverse(-lin.r),
        images.moves,
    )
    after = slice(6 + of.images.start, None)
    away = (state.numbers - state.base)[of.images]
    info, pull = np.zeros((6 + count, 6 + count)), np.zeros(6 + count)
    info[after, after] = images.info
    pull[after] = images.pull + images.info @ away
    return Observations(
        r=lin.r,
        of_global=derivatives if n > _MANY else derivatives[:],
        of_local=lin.J[:, :, 6:],
        group=lin.problem.group,
        parts=shapes(lin, tuple(state.components.sigma)),
        info=info,
        pull=pull,
        sse=float(lin.problem.sse.sum() + (2.0 * images.pull + images.info @ away) @ away),
        dof=float(lin.problem.dof.sum()),
    )


def budget(eq: Equations, blocks: Mapping[str, slice]) -> dict[str, Array]:
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
    budget[NOISE] = left
    return budget
