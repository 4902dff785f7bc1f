"""Whether a tool with its new frame meets the beams where the reference did."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtri

from calibration.lengths import length_beyond
from calibration.odds import FALSE_ALARM, FOUND
from cell.poses import Array


@dataclass(frozen=True, eq=False)
class PointComparison:
    """``apart`` (3,) m in the base is the tool's point at the hit of the second scan minus the reference's;
    ``U`` (m) is the length that such distances are beyond with the stated chance when the new frame is right,
    ``detectable`` (m) that of an error of the frame that is found with 99 % at least."""

    apart: Array
    U: float
    detectable: float

    @property
    def distance(self) -> float:
        return float(np.linalg.norm(self.apart))

    @property
    def meets(self) -> bool:
        return self.distance <= self.U


def tool_point_meets(
    t_new: ArrayLike,
    t_ref: ArrayLike,
    dp_first: ArrayLike,
    between: ArrayLike,
    cov_between: ArrayLike,
    R: ArrayLike,
    chance: float = FALSE_ALARM,
) -> PointComparison:
    """The point ``p + R t_new`` at the hit of the second scan against the reference's hit, ``p + R t_ref``.

    ``t_new`` and ``t_ref`` (3,) m are the tool's point of the candidate and of the reference in the flange;
    ``dp_first`` (3,) m is the displacement that the first scan found against the reference, ``between`` that
    of the second scan against the first one, so that the second finds ``dp_first + between`` against the
    reference. ``cov_between`` (3, 3) or larger with the point first belongs to ``between`` alone: the noise
    of the reference is in both scans alike and cancels. ``R`` (3, 3) is R_base_flange, ``chance`` that of a
    right frame to be judged wrong. The raw offset of the flange does not become zero: the flange is where the
    point is at the beam.
    """
    cov = np.asarray(cov_between, dtype=float)[:3, :3]
    off = np.asarray(t_new, dtype=float) - np.asarray(t_ref, dtype=float)
    off = off - np.asarray(dp_first, dtype=float) - np.asarray(between, dtype=float)
    U = length_beyond(cov, chance)
    return PointComparison(np.asarray(R, dtype=float) @ off, U, detectable(cov, U))


def detectable(cov: Array, limit: float) -> float:
    """The size of a true difference that is found beyond ``limit`` with 99 % at least, whichever way it
    points; ``cov`` (k, k) is that of the measured difference."""
    worst = float(np.max(np.linalg.eigvalsh(cov)))
    return limit + float(ndtri(FOUND)) * float(np.sqrt(max(worst, 0.0)))
