"""What an arm differs from its model in: geometry, gears and sag, as small motions of the flange.

A term is a column of twists: the motion of the flange, in its own frame, for a unit of one number. Numbers
that move base or flange as a whole say nothing of the arm: their part is taken out, so that a camera's or a
target's pose keeps its meaning, the one that serves best with the arm's model over all its joints.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.hand_eye import se3
from calibration.kinematics.chain import SerialChain
from calibration.kinematics.joint_errors import JointErrors, of_gears, of_sag
from calibration.kinematics.parametric import ParametricArm
from cell.even_points import even_points
from cell.formats.robot import Prior
from cell.poses import Array, adjoint

REFERENCE = 10  # two to this power joint vectors stand for all that the arm can reach
_LEVER_M = 0.3  # at which a turn counts as much as a shift
_SEED = 20
_LATTICE, _GENERATOR = 1021, 497  # the best of this size in six dimensions, for second powers


@dataclass(frozen=True)
class ArmTerms:
    """Terms of one block: ``names`` (p,), prior ``sigma`` (p,), and twists ``columns`` (n, 6, p).

    ``gauge`` (12, p): the motions of base (in the base) and flange (in the flange) that were taken out.
    """

    names: tuple[str, ...]
    sigma: Array
    columns: Array
    gauge: Array


@dataclass(frozen=True)
class ArmPrior:
    """Standard deviations of an arm's numbers: lengths (m), angles (rad), gears and sag (rad)."""

    length: float = 2e-4
    angle: float = 3e-4
    gear: float = 2e-5
    sag: float = 1e-4


def arm_prior(given: Prior | None) -> ArmPrior:
    """What a ROBOT says of its numbers; the usual where it says nothing."""
    usual = ArmPrior()
    if given is None:
        return usual
    return ArmPrior(
        given.length_m or usual.length,
        given.angle_rad or usual.angle,
        given.gear_rad or usual.gear,
        given.sag_rad or usual.sag,
    )


def geometry(arm: ParametricArm, Q: Array, prior: ArmPrior) -> ArmTerms:
    """Deviations of the numbers of the chain at joints ``Q`` (n, j) in rad."""
    kinds = np.array(arm.kinds)
    sigma = np.where(kinds == "length", prior.length, prior.angle)
    return ArmTerms(arm.names, sigma, twists(arm, Q), np.zeros((12, len(sigma))))


def gears_and_sag(
    chain: SerialChain, Q: Array, prior: ArmPrior, errors: JointErrors | None = None
) -> ArmTerms:
    """Errors of the joints' angles once and twice a turn, and the loaded joints giving way to gravity.

    ``errors`` are those that ``chain`` may have, unless they are others.
    """
    errors = errors or joint_errors(chain)
    frames = chain.frames(Q)
    at_flange = _into_flange(frames[:, -1], chain.jacobians(frames))[:, :, errors.joint]
    columns = np.concatenate([at_flange * wave.T[:, None] for wave in errors.waves(Q)], axis=2)
    free = free_amplitudes(errors)
    names = tuple(name for name, is_free in zip(errors.amplitudes, free, strict=True) if is_free)
    sigma = np.array([prior.gear if name.startswith("gear") else prior.sag for name in names])
    return ArmTerms(names, sigma, columns[:, :, free], np.zeros((12, len(sigma))))


def joint_errors(chain: SerialChain) -> JointErrors:
    """The errors of gears and sag that a chain may have; zero so far."""
    gears = of_gears(chain.coupling, chain.sliding)
    return of_sag(chain.coupling, chain.alpha, chain.sliding).beside(gears)


def free_amplitudes(errors: JointErrors) -> NDArray[np.bool_]:
    """Which amplitudes are unknowns: weight goes with the cosine of a link's angle to the horizontal, which
    the joints of an upright arm count from."""
    return np.array([not (n.startswith("sag") and n.endswith(".sin")) for n in errors.amplitudes])


def twists(arm: ParametricArm, Q: Array) -> Array:
    """(n, 6, p): motion of the flange in its own frame for a unit of each number of ``arm``."""
    walk = arm.base.walk(Q)
    origin = arm.columns(Q, walk, walk.o[-1])
    tips = [arm.columns(Q, walk, walk.o[-1] + axis[-1]) for axis in (walk.x, walk.y, walk.z)]
    axes = (walk.x[-1], walk.y[-1], walk.z[-1])
    # a turn w moves the tip of axis k by w x k: two of its three parts along the other axes give w
    turn = [
        np.sum((tips[1] - origin) * axes[2], axis=1),
        np.sum((tips[2] - origin) * axes[0], axis=1),
        np.sum((tips[0] - origin) * axes[1], axis=1),
    ]
    shift = [np.sum(origin * axis, axis=1) for axis in axes]
    return np.stack([*shift, *turn], axis=0).transpose(2, 0, 1)


def common_motion(columns: Array, flange: Array) -> Array:
    """(12, p): the motions of base (in the base) and flange (in the flange) that are nearest to ``columns``.

    ``columns`` (k, 6, p) are the terms at poses ``flange`` (k, 4, 4), spread over all that the arm reaches.
    """
    scale = np.array([1.0] * 3 + [_LEVER_M] * 3)
    base = adjoint(se3.inverse(flange)) * scale[:, None]
    own = np.broadcast_to(np.diag(scale), base.shape)
    A = np.concatenate([base, own], axis=2).reshape(-1, 12)
    b = (columns * scale[:, None]).reshape(len(A), -1)
    return np.asarray(np.linalg.lstsq(A, b, rcond=None)[0], dtype=float)


def without_gauge(terms: ArmTerms, flange: Array, gauge: Array) -> ArmTerms:
    """``terms`` at poses ``flange`` (n, 4, 4) less the motions ``gauge`` (12, p) of base and flange."""
    columns = terms.columns - adjoint(se3.inverse(flange)) @ gauge[:6] - gauge[6:]
    return ArmTerms(terms.names, terms.sigma, columns, gauge)


def reference_joints(limits: Array, power: int = REFERENCE, seed: int = _SEED) -> Array:
    """(2 ** power, j) joints spread evenly over the ``limits`` (j, 2) rad, at most half a turn either way."""
    low, high = np.maximum(limits[:, 0], -np.pi), np.minimum(limits[:, 1], np.pi)
    even = even_points(len(limits), power, seed)
    return np.asarray(low + (high - low) * even)


def joints_to_average(limits: Array) -> Array:
    """(1021, j) joints over the ``limits`` (j, 2) rad, at most half a turn either way, for means over all.

    Where all joints turn once round, means of base and flange are trigonometric polynomials of low degree,
    and this lattice has them but for rounding; a joint that turns less is passed there and back.
    Source: Korobov's lattices, Sloan and Joe, Lattice Methods for Multiple Integration (1994), ch. 4.
    """
    low, high = np.maximum(limits[:, 0], -np.pi), np.minimum(limits[:, 1], np.pi)
    step = np.array([pow(_GENERATOR, k, _LATTICE) for k in range(len(limits))])
    even = np.arange(_LATTICE)[:, None] * step % _LATTICE / _LATTICE
    round_once = high - low > 2.0 * np.pi - 1e-6
    return np.asarray(low + (high - low) * np.where(round_once, even, 1.0 - np.abs(2.0 * even - 1.0)))


def _into_flange(T: Array, J: Array) -> Array:
    """Velocities (n, 6, j) of the flange's origin in the base, in the flange's frame instead."""
    R = np.swapaxes(T[:, :3, :3], 1, 2)
    return np.concatenate([R @ J[:, :3], R @ J[:, 3:]], axis=1)
