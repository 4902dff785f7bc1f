"""Whether ranges are all wrong by one length: a reflector's constant, or its kind, is not what was set.

A score test: what the weighted squares would lose by an offset along the beams, without solving again,
against what chance takes away. Arm and tracker's place take up much of an offset; only the rest can show it.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import fdtri

from calibration.identification.reflector_constant import CHANCE, along_beams
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
    if (seen := along_beams(solution)) is None:
        return None
    part, cov, left = seen.part, seen.cov, seen.left
    r = (seen.e * seen.weight).ravel()
    A = (seen.J * seen.weight).reshape(len(seen.J), -1)
    beams = seen.beams * seen.weight
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
