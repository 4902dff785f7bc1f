"""How well an arm comes back: what its data sheet says, and what the passes across the beams show.

A pass goes by as the arm then is, off by its repeatability, across the beam and along the tool alike. Across
the scatter of many edges is seen; along the tool few passes are near the end. So what ways are seen to be off
by across, with what the maker states, is what is expected along the tool; what each edge has of its own, as
of reading the pose, is not.
"""

from dataclasses import dataclass

import numpy as np

from cell.poses import Array

# Pose repeatability in the manner of ISO 9283, m, from the makers' data sheets. It is the mean distance and
# three standard deviations of it: 3.6 standard deviations of one axis. Others are taken as usual arms.
STATED_RP_M = {
    "ur3": 1e-4,
    "ur5": 1e-4,
    "ur10": 1e-4,
    "ur3e": 3e-5,
    "ur5e": 3e-5,
    "ur7e": 3e-5,
    "ur10e": 5e-5,
    "ur12e": 5e-5,
    "ur16e": 5e-5,
    "ur20": 1e-4,
    "ur30": 1e-4,
}
AXES_OF_RP = 3.6
UNKNOWN_RP_M = 5e-5
UNDER_WAY = float(np.sqrt(0.5))  # between two standstills an arm is off by a part of each
USUAL_WAY_M = UNDER_WAY * UNKNOWN_RP_M / AXES_OF_RP
_SIGMAS_M = np.geomspace(1.5e-6, 9e-5, 17)  # in steps of 1.3: as fine as many edges know it
_LIKELY = -6.0
_SPREAD_STATED, _SPREAD_USUAL = 0.6, 1.0  # of the logarithm


@dataclass(frozen=True, eq=False)
class PassScatter:
    """``sigmas`` (S,) m of single passes, and ``log_prior`` (S,) how likely each is before any height."""

    sigmas: Array
    log_prior: Array

    @property
    def usual(self) -> float:
        """The geometric mean, m."""
        w = np.exp(self.log_prior - np.max(self.log_prior))
        return float(np.exp(w @ np.log(self.sigmas) / np.sum(w)))

    @property
    def coarser(self) -> "PassScatter":
        """With every fourth of ``sigmas``."""
        return PassScatter(self.sigmas[::4], self.log_prior[::4])


def stated_sigma(model: str | None) -> float:
    """Standard deviation of one axis (m) of the arm ``model``, by its data sheet; else that of usual arms."""
    return STATED_RP_M.get(model or "", UNKNOWN_RP_M) / AXES_OF_RP


def of_a_way(stated: float | None) -> float:
    """What a single way is expected to scatter by (m); ``stated`` as in :func:`scatter_of`."""
    return USUAL_WAY_M if stated is None else UNDER_WAY * stated


def scatter_of(stated: float | None, seen: float | None = None, spread: float = 0.2) -> PassScatter:
    """``stated`` (m) is one axis by the data sheet, None when the arm is not known; ``seen`` (m) what ways
    scatter by across the beams, whose logarithm is known to ``spread``."""
    log = np.log(_SIGMAS_M)
    prior = (
        -0.5 * ((log - np.log(of_a_way(stated))) / (_SPREAD_USUAL if stated is None else _SPREAD_STATED)) ** 2
    )
    if seen is not None:
        prior = prior - 0.5 * ((log - np.log(np.clip(seen, _SIGMAS_M[0], _SIGMAS_M[-1]))) / spread) ** 2
    prior = prior - np.max(prior)
    likely = prior > _LIKELY
    return PassScatter(_SIGMAS_M[likely], prior[likely])
