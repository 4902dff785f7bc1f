"""Whether ranges are all wrong by one length: a reflector's constant, or its kind, is not what was set.

A score test: what the weighted squares would lose by an offset along the beams, without solving again,
against what chance takes away. Arm and tracker's place take up much of an offset; only the rest can show it.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import fdtri

from calibration.identification.constant import CHANCE, without_constant
from calibration.identification.solution import Solution


@dataclass(frozen=True)
class RangeOffset:
    """``offset_m`` is what ranges to ``targets`` are too long by, what was taken out of them included;
    ``sigma_m`` its standard deviation, ``significant`` when chance does not explain it."""

    targets: tuple[str, ...]
    offset_m: float
    sigma_m: float
    significant: bool


def range_offset(solution: Solution) -> RangeOffset | None:
    """The offset that readings ask for most, of all reflectors together or of one; None without a covariance
    or with too few readings."""
    problem, cov = solution.problem, without_constant(solution)
    rows = np.flatnonzero(solution.used)
    left = 3 * len(rows) - solution.unknowns - 1
    if cov is None or left < 3:
        return None
    part = problem.take(rows)
    _, J = part.model.linearised(solution.x, part.Q, part.target)
    weight = 1.0 / (np.sqrt(solution.excess) * solution.noise.sigma(part.range_m))
    r = (solution.e[:, rows] * weight).ravel()
    A = (J * weight).reshape(len(J), -1)
    beams = solution.registration.R.T @ (part.p / part.range_m) * weight
    names = part.model.targets
    found: list[tuple[float, RangeOffset]] = []
    for own in [tuple(names), *((name,) for name in names)][: 1 if len(names) == 1 else None]:
        mine = np.isin(part.target, [names.index(name) for name in own])
        g = (beams * mine).ravel()
        information = float(g @ g - (A @ g) @ cov @ (A @ g))
        if not information > 0.0:
            continue
        gain = float(g @ r) ** 2 / information
        rest = max(float(r @ r) - gain, 1e-12)
        ratio = gain / (rest / left)
        offset = RangeOffset(
            own,
            solution.constant_m + float(g @ r) / information,
            information**-0.5,
            ratio > float(fdtri(1, left, 1.0 - CHANCE)),
        )
        found.append((ratio, offset))
    return max(found, key=lambda pair: pair[0])[1] if found else None
