"""A reflector's constant: one length by which all ranges may be wrong, as far as it is known.

It is a nuisance of the model, with the prior that somebody states for it (``sigma_constant``): readings and
prior together say how large it is, readings are freed of that, and what stays open of it is in the covariance
of every prediction. Arm and tracker's place take up nearly all of a constant, so readings alone tell it badly
and predictions move with it one to one: without a stated prior it is taken as right, and :func:`unnoticed`
says what that may cost.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import fdtri, ndtri

from calibration.identification.estimator import Problem
from calibration.identification.solution import Solution, identify
from cell.poses import Array

KEY = "sigma_constant"  # of a data set's noise, m
CHANCE = 1e-4  # of blaming a reflector that is as it was set
_FOUND = 0.95  # of wrong constants larger than what is said to stay unnoticed
_ROUNDS = 4
_SETTLED = 0.02  # of its own standard deviation


@dataclass(frozen=True, eq=False)
class Constant:
    """What readings alone say of a common constant: ranges are too long by ``offset_m``, give or take
    ``sigma_m``. One metre of it moves parameters and registration by ``shift`` (p + 6,); ``left`` are the
    degrees of freedom of the residuals."""

    offset_m: float
    sigma_m: float
    shift: Array
    left: float


@dataclass(frozen=True, eq=False)
class AlongBeams:
    """The readings that made a solution, as a test of their ranges looks at them: ``part`` of the problem,
    residuals ``e`` (3, n) and ``beams`` (3, n, unit vectors) in the base, derivatives ``J`` (p + 6, 3, n),
    ``weight`` (n,) one over the standard deviation, ``cov`` as if the constant were known, and the degrees
    of freedom that one more unknown leaves."""

    part: Problem
    e: Array
    beams: Array
    J: Array
    weight: Array
    cov: Array
    left: float


def along_beams(solution: Solution) -> AlongBeams | None:
    """None without a covariance, or with too few readings."""
    cov, rows = without_constant(solution), np.flatnonzero(solution.used)
    left = 3 * len(rows) - solution.unknowns - 1
    if cov is None or left < 3:
        return None
    part = solution.problem.take(rows)
    _, J = part.model.linearised(solution.x, part.Q, part.target)
    weight = 1.0 / (np.sqrt(solution.excess) * solution.noise.sigma(part.range_m))
    beams = solution.registration.R.T @ (part.p / part.range_m)
    return AlongBeams(part, solution.e[:, rows], beams, J, weight, cov, left)


def constant_of(solution: Solution) -> Constant | None:
    """None without a covariance, or with too few readings."""
    if (seen := along_beams(solution)) is None:
        return None
    shift, information = _shift(seen.cov, seen.J, seen.beams, seen.weight)
    if not information > 0.0:
        return None
    along = float(np.sum(seen.beams * seen.e * seen.weight**2))
    return Constant(along / information, information**-0.5, shift, seen.left)


def identify_with_constant(
    problem: Problem, given_noise: Mapping[str, float], joint_errors: bool = False
) -> Solution:
    """As :func:`identify`; with ``sigma_constant`` (m) in ``given_noise`` the constant is determined as well.

    The solution's problem then has the readings as a right constant would have them, ``constant_m`` shorter.
    """
    found, sigma, taken = identify(problem, given_noise, joint_errors), given_noise.get(KEY, 0.0), 0.0
    if not sigma > 0.0:
        return found
    told = constant_of(found)
    for _ in range(_ROUNDS):
        if told is None:
            return found
        wanted = (taken + told.offset_m) * sigma**2 / (sigma**2 + told.sigma_m**2)
        if abs(wanted - taken) < _SETTLED * told.sigma_m:
            break
        taken = wanted
        shorter = replace(problem, p=problem.p * (1.0 - taken / problem.range_m))
        found = identify(shorter, given_noise, joint_errors)
        told = constant_of(found)
    if told is None or found.cov is None:
        return found
    left = 1.0 / np.hypot(1.0 / sigma, 1.0 / told.sigma_m)
    cov = found.cov + left**2 * np.outer(told.shift, told.shift)
    return replace(
        found, cov=cov, constant_m=taken, constant_sigma_m=float(left), cov_constant_known=found.cov
    )


def without_constant(solution: Solution) -> Array | None:
    """(p + 6, p + 6): the covariance if the constant were known; None where a method has none."""
    return solution.cov if solution.cov_constant_known is None else solution.cov_constant_known


def open_constant(cov: Array, J: Array, beams: Array, weight: Array, sigma_m: float) -> Array:
    """(p + 6, p + 6): what is added to ``cov`` by a constant with the prior ``sigma_m``, before measuring.

    ``J`` (p + 6, 3, n) are derivatives at the poses, ``beams`` (3, n) unit vectors along the beams (base),
    ``weight`` (n,) is one over the standard deviation of a reading.
    """
    shift, information = _shift(cov, J, beams, weight)
    out: Array = np.outer(shift, shift) / (information + sigma_m**-2.0)
    return out


def _shift(cov: Array, J: Array, beams: Array, weight: Array) -> tuple[Array, float]:
    """(p + 6,) by which a metre of the constant moves the unknowns, and the information (1/m^2) on it."""
    A, g = (J * weight).reshape(len(J), -1), (beams * weight).ravel()
    shift: Array = cov @ (A @ g)
    return shift, float(g @ g - (A @ g) @ shift)


def unnoticed(told: Constant) -> float:
    """The smallest wrong constant (m) that the score test finds in 95 of 100 sets of such readings."""
    threshold = float(np.sqrt(fdtri(1, told.left, 1.0 - CHANCE)))
    return (threshold + float(ndtri(_FOUND))) * told.sigma_m


def moved(told: Constant, J: Array) -> Array:
    """(n,): how far one metre of the constant moves places with derivatives ``J`` (p + 6, 3, n), m."""
    out: Array = np.linalg.norm(np.einsum("k,kan->na", told.shift, J), axis=1)
    return out
