"""What a board tells of an arm: its corrected numbers, where its flange truly is, and how far off it was.

A motion of base or flange as a whole is no error of the arm. It is left out of the flange's poses; in a ROBOT
it is not, so the camera has another pose on the corrected arm than on the arm as it is configured.
"""

from dataclasses import dataclass

import numpy as np

from calibration.adjustment.arm_about import ArmAbout, arm_with
from calibration.adjustment.arm_terms import reference_joints
from calibration.adjustment.hand_eye import Adjusted
from calibration.adjustment.unknowns import GEARS, GEOMETRY, ArmKnown, arm_terms
from calibration.hand_eye import se3
from calibration.kinematics.parametric import ParametricArm
from cell.poses import Array, adjoint

_EXPECTED = 0.95
_DRAWS, _DRAWS_EVERYWHERE, _SEED = 400, 100, 11
_REPEATABLE_M = 3e-5  # of a flange, along one axis: a scatter up to this is no error of the arm's model


@dataclass(frozen=True)
class FlangeError:
    """Of the flange: root mean square error in m and rad, and the length that 95 % of the position's errors
    over the joints stay below, in m."""

    t: float
    r: float
    t95: float


@dataclass(frozen=True)
class ArmAccuracy:
    """``configured``: of the arm by its model; ``corrected``: with all that was found taken off."""

    configured: FlangeError
    corrected: FlangeError


@dataclass(frozen=True)
class PositionAccuracy:
    """RMS position (m) of the flange: by its model ``before``, expected to be left ``after``, and the length
    that 95 % of the errors left stay below."""

    before: float
    after: float
    after95: float


def arm_accuracy(found: Adjusted, arm: ArmKnown) -> ArmAccuracy:
    """Over the reference joints, which are spread over all that the arm can reach.

    At each of them the expected square is that of the error found plus its variance; with the error
    corrected the variance alone is left.
    """
    part = arm_numbers(found)
    error, columns = flange_errors(found, arm, reference_joints(arm.limits))
    spread = columns @ _root(found.cov_numbers[part, part])
    return ArmAccuracy(_flange_error(error, spread), _flange_error(np.zeros_like(error), spread))


def position_metric(arm: ArmKnown) -> Array:
    """M (a, a): numbers with covariance C leave ``trace(M C)`` (m^2) of position error of the flange, the
    mean square over the reference joints."""
    J = arm_columns(arm, reference_joints(arm.limits))[:, :3]
    return np.asarray(np.einsum("kia,kib->ab", J, J, optimize=True) / len(J))


def position_accuracy(found: Adjusted, arm: ArmKnown, Q: Array) -> PositionAccuracy:
    """At joints ``Q`` (k, 6), after the base and the tool offset that fit best there are taken off."""
    part = arm_numbers(found)
    errors, columns = flange_errors(found, arm, Q)
    error, J = _positions(arm, Q, errors[:, :, None]).reshape(-1, 3), _positions(arm, Q, columns)
    root = _root(found.cov_numbers[part, part])
    draws = np.random.default_rng(_SEED).normal(size=(root.shape[1], _DRAWS))
    left = np.linalg.norm((J @ (root @ draws)).reshape(len(Q), 3, _DRAWS), axis=1)
    spread = J @ root
    return PositionAccuracy(
        float(np.sqrt(np.mean(np.sum(error**2, axis=1)))),
        float(np.sqrt(np.sum(spread**2) / len(Q))),
        float(np.quantile(left, _EXPECTED)),
    )


def predicted_flange(found: Adjusted, arm: ArmKnown, Q: Array) -> tuple[Array, Array]:
    """Where the flange is at joints ``Q`` (k, 6): poses (k, 4, 4), and covariances (k, 3, 3) of the place.

    Base and tool offset that fit best at these joints are not in the covariance; a scatter of the flange
    beyond what an arm repeats to is, since the model does not follow it.
    """
    part = arm_numbers(found)
    error, columns = flange_errors(found, arm, Q)
    T = arm.model.base.flange(Q) @ se3.exp(error)
    spread = (_positions(arm, Q, columns) @ _root(found.cov_numbers[part, part])).reshape(len(Q), 3, -1)
    scatter = found.components.sigma.get("sigma_flange_t", 0.0)
    beyond = max(scatter**2 - _REPEATABLE_M**2, 0.0)
    return T, spread @ np.swapaxes(spread, 1, 2) + beyond * np.eye(3)


def corrected_arm(found: Adjusted, arm: ArmKnown) -> tuple[ParametricArm, Array]:
    """The arm with its joint errors, and the values (p,) of its numbers."""
    return arm_with(found.numbers[arm_numbers(found)], arm)


def on_corrected_arm(found: Adjusted, arm: ArmKnown) -> tuple[Array, Array]:
    """X (4, 4) and its covariance (6, 6) for the flange, or the base, of :func:`corrected_arm`."""
    part = arm_numbers(found)
    moved, by_numbers = camera_on_true_arm(found, arm)
    mixed = found.cross[:, part] @ by_numbers.T
    cov = found.cov + mixed + mixed.T + by_numbers @ found.cov_numbers[part, part] @ by_numbers.T
    return moved @ found.X, cov


def camera_on_true_arm(found: Adjusted, arm: ArmKnown) -> tuple[Array, Array]:
    """``moved`` (4, 4): X for the corrected arm's own flange, or base, is ``moved @ found.X``; and how it
    moves further, in its own frame, by a change of each number (6, a), where the found X stays."""
    part = arm_numbers(found)
    if found.arm_at.any():
        about = ArmAbout(arm, found.numbers[part])
        gauge, (base, flange) = about.gauge, about.ends
    else:
        gauge = _gauge(arm)
        ends = gauge @ found.numbers[part]
        base, flange = se3.exp(ends[:6]), se3.exp(ends[6:])
    to_own = adjoint(se3.inverse(found.X))
    if found.problem.setup == "eye-in-hand":
        return se3.inverse(flange), -to_own @ gauge[6:]
    return base, to_own @ gauge[:6]


def true_flange(found: Adjusted, arm: ArmKnown, Q: Array) -> tuple[Array, Array]:
    """Flange (n, 4, 4) of the corrected arm at joints ``Q`` (n, 6), with its own base and flange, and its
    motion in its own frame by a change of each number (n, 6, a)."""
    numbers = found.numbers[arm_numbers(found)]
    if found.arm_at.any():
        about = ArmAbout(arm, numbers)
        return about.true_flange(Q), about.true_columns(Q)
    F, gauge = arm.model.base.flange(Q), _gauge(arm)
    columns = arm_columns(arm, Q) + adjoint(se3.inverse(F)) @ gauge[:6] + gauge[6:]
    return F @ se3.exp(columns @ numbers), columns


def _gauge(arm: ArmKnown) -> Array:
    """(12, a) motions of base and flange that are taken out of the terms of ``arm``."""
    return np.concatenate([terms.gauge for terms in arm_terms(arm, arm.Q[:1]).values()], axis=1)


def arm_numbers(found: Adjusted) -> slice:
    """Where the arm's numbers are among those that were found."""
    return slice(found.blocks[GEOMETRY].start, found.blocks[GEARS].stop)


def arm_columns(arm: ArmKnown, Q: Array) -> Array:
    """(k, 6, a): motion of the flange, in its own frame, by each of the arm's numbers, at joints (k, 6)."""
    return np.concatenate([terms.columns for terms in arm_terms(arm, Q).values()], axis=2)


def flange_errors(found: Adjusted, arm: ArmKnown, Q: Array) -> tuple[Array, Array]:
    """At joints ``Q`` (k, 6): motion (k, 6) of the flange, in its own frame, by all that was found,
    and by a change of each number (k, 6, a)."""
    numbers = found.numbers[arm_numbers(found)]
    if not found.arm_at.any():
        columns = arm_columns(arm, Q)
        return columns @ numbers, columns
    about = ArmAbout(arm, numbers)
    return se3.log(about.motion(Q)), about.columns(Q)


def _positions(arm: ArmKnown, Q: Array, columns: Array) -> Array:
    """(3 k, p): how the ``columns`` (k, 6, p) move the flange's places in the base, beyond one base and one
    tool offset."""
    T = arm.model.base.flange(Q)
    R, places = T[:, :3, :3], T[:, :3, 3]
    J = (R @ columns[:, :3]).reshape(3 * len(Q), -1)
    lever = se3.hat(places)
    own = np.concatenate([np.tile(np.eye(3), (len(Q), 1, 1)), -lever, R], axis=2).reshape(3 * len(Q), 9)
    return np.asarray(J - own @ np.linalg.lstsq(own, J, rcond=None)[0])


def _root(cov: Array) -> Array:
    """A with ``A A^T = cov``, for a covariance that rounding may have made indefinite.

    The symmetric root of the correlations: it follows the covariance continuously, so figures from seeded
    draws do not hang on the signs and the order of eigenvectors, which differ between processors.
    """
    s = np.sqrt(np.maximum(np.diag(cov), 1e-300))
    return np.asarray(s[:, None] * symmetric_root(cov / np.outer(s, s)))


def symmetric_root(cov: Array) -> Array:
    """A (n, n) with ``A A = cov`` and ``A = A^T``; what rounding made of a variance below 0 is taken as 0."""
    values, vectors = np.linalg.eigh(cov)
    return np.asarray((vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T)


def _flange_error(error: Array, spread: Array) -> FlangeError:
    """Of errors (k, 6), place first, known to ``spread @ z`` with m numbers z of variance 1: (k, 6, m)."""
    squares = error**2 + np.sum(spread**2, axis=2)
    t, r = (float(np.sqrt(part.sum(axis=1).mean())) for part in (squares[:, :3], squares[:, 3:]))
    z = np.random.default_rng(_SEED).normal(size=(spread.shape[2], _DRAWS_EVERYWHERE))
    drawn = np.linalg.norm(error[:, :3, None] + spread[:, :3] @ z, axis=1)
    return FlangeError(t, r, float(np.quantile(drawn, _EXPECTED)))
