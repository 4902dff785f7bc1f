"""Whether a tool with its new frame meets the beams where the reference did."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import chdtri

from cell.poses import Array

COVERAGE = 0.95


@dataclass(frozen=True, eq=False)
class Meeting:
    """``apart`` (3,) m in the base is the tool's point at the hit of the second scan minus the reference's;
    ``U`` (m) is the length that 95 % of such distances stay below when the new frame is right."""

    apart: Array
    U: float

    @property
    def distance(self) -> float:
        return float(np.linalg.norm(self.apart))

    @property
    def meets(self) -> bool:
        return self.distance <= self.U


def tool_point_meets(
    t_new: ArrayLike,
    t_ref: ArrayLike,
    dp_second: ArrayLike,
    cov_second: ArrayLike,
    cov_new: ArrayLike | None,
    R: ArrayLike,
) -> Meeting:
    """The point ``p + R t_new`` at the hit of the second scan against the reference's hit, ``p + R t_ref``.

    ``t_new`` and ``t_ref`` (3,) m are the tool's point of the candidate and of the reference in the flange;
    ``dp_second`` (3,) m is the displacement that the second scan finds against the reference, so that its
    flange was at ``p_ref - R dp_second``. ``cov_second`` belongs to it and ``cov_new`` to ``t_new``, both
    (3, 3) or larger with the point first; None takes the new frame to be as uncertain as the second scan.
    ``R`` (3, 3) is R_base_flange. The raw offset of the flange does not become zero: the flange is where the
    point is at the beam.
    """
    second = np.asarray(cov_second, dtype=float)[:3, :3]
    new = second if cov_new is None else np.asarray(cov_new, dtype=float)[:3, :3]
    off = np.asarray(t_new, dtype=float) - np.asarray(t_ref, dtype=float) - np.asarray(dp_second, dtype=float)
    return Meeting(np.asarray(R, dtype=float) @ off, length95(second + new))


def length95(cov: Array) -> float:
    """The length that 95 % of normal vectors with covariance ``cov`` (k, k) stay below."""
    return length_beyond(cov, 1.0 - COVERAGE)


def length_beyond(cov: Array, probability: float) -> float:
    """The length that normal vectors with covariance ``cov`` (k, k) are beyond with ``probability``.

    A scaled chi-square with the mean and variance of the squared length (Satterthwaite 1946).
    """
    mean, half = float(np.trace(cov)), float(np.sum(cov * cov))
    if half <= 0.0:
        return 0.0
    scale = half / mean
    return float(np.sqrt(scale * chdtri(mean / scale, probability)))
