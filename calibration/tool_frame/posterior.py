"""Mean and covariance under the likelihood of intervals.

Each edge is somewhere in its interval with equal probability, but for a little normal noise. Most of that
is the arm's, which is off by nearly the same at both edges of a way: a share of the noise's variance, which
is not known, is an offset ``w`` of the way, the rest is the edge's own. Of ``w`` half comes from the
standstill before the way and half from the one after it, which it has in common with its neighbours. Polls
often come at the same phase of both edges, as a chord takes as long in every way, and two edges that were
taken one by one would then tell the same thing twice; so would two ways with one standstill. With ``w`` held
the likelihood of an edge is ``Phi((high - u)/s) - Phi((low - u)/s)``. That is a polytope with soft faces,
narrow and with corners, which no normal proposal fits; so it is walked through. Beside each edge's ``u``
stands where the input was seen to change, ``y = u + w - s z``, which lies in the interval, ``z`` being the
noise of its own. The steps are exact draws:

- ``y`` with ``u`` and ``w`` held: a normal cut off at the interval's ends;
- the unknowns with all ``y`` held: normal, as in least squares of edges that are off together, and then
  the standstills. That goes far where noise is large;
- every second standstill with all else and ``z`` held, and then the others: a normal cut off where the first
  interval of its ways ends. That goes far where edges have little noise of their own;
- the unknowns with all ``w`` and ``z`` held, along a line: even between the ends that the intervals leave.
  That goes far where noise is small.

Source of the pair of least squares and lines: Yu and Meng, "To center or not to center" (2011); of the walk
along lines: Smith, "Efficient Monte Carlo procedures" (1984). The noise is unknown as well and takes its own
step, with ``y`` left open (Metropolis), once with ``w`` held and once with ``w`` in units of the noise, and
so does the edges' own share of it. Many walks go side by side from points that are spread as averaging says;
their mean is what it would be after any number of sweeps to a tenth of a standard deviation. Random numbers
are the same in every call.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from calibration.tool_frame.averaging import AveragingFit
from calibration.tool_frame.bounds import LateralModel, Rows
from calibration.tool_frame.repeatability import USUAL_WAY_M
from calibration.tool_frame.standstills import WITHIN
from calibration.tool_frame.walks import Walks
from cell.poses import Array

_SETTLE = 60  # sweeps until the start is forgotten; more change nothing
_ADAPT = (3, 6, 10, 15, 20, 30)  # after these the lines' directions are those of the walks' own spread
_KEEP = 24  # sweeps that count, worth two or three independent ones
_WALKS_PER_UNKNOWN = 2  # at least, for directions that can be told


@dataclass(frozen=True)
class Noise:
    """What single edges scatter by, what is common to both edges of a way included.

    ``sigma`` (m) is the root of its mean square. ``of_way`` (m) is the same of what is common to a way: what
    the arm is off by, without what each edge has of its own; ``spread`` the standard deviation of its
    logarithm.
    """

    sigma: float
    of_way: float
    spread: float

    @classmethod
    def usual(cls, sigma: float, spread: float) -> Self:
        """With the usual share of a way."""
        return cls(sigma, float(np.sqrt(WITHIN)) * sigma, spread)


@dataclass(frozen=True, eq=False)
class Posterior:
    """``mean`` (d + m,) and ``cov`` of the unknowns and then the edges' places, ``noise`` of edges.

    ``effective`` the number of independent points that the averages are worth: the mean is off by about
    ``1/sqrt(effective)`` of a standard deviation.
    """

    mean: Array
    cov: Array
    noise: Noise
    effective: float

    def psi(self, d: int) -> Array:
        """(d,) mean of the unknowns without the edges."""
        return self.mean[:d]


def posterior(
    rows: Rows,
    model: LateralModel,
    start: AveragingFit,
    noise: float,
    points: int = 2048,
    known_noise: float | None = None,
    usual_noise: float = USUAL_WAY_M,
    neighbours: Sequence[tuple[int, int]] = (),
) -> Posterior:
    """``start`` is the solution by averaging, ``noise`` (m) what it shows beyond the intervals' widths;
    ``neighbours`` are the ways (by their places in the scene) that share a standstill.

    About ``points`` places are averaged: a few hundred do for the mean, but 1500 and more for a covariance,
    which with few edges hangs on how seldom there is much noise. ``known_noise`` (m) when the noise need not
    be found, ``usual_noise`` (m) what half of all arms of this kind stay below.
    """
    least = _WALKS_PER_UNKNOWN * (rows.X.shape[1] + len(rows.labels))
    count = max(points // _KEEP, least)
    walks = Walks(rows, model, start, noise, count, known_noise, usual_noise, neighbours)
    for sweep in range(_SETTLE):
        walks.sweep()
        if sweep in _ADAPT:
            walks.adapt()
    kept, sigmas, of_ways = [], [], []
    for _ in range(_KEEP):
        walks.sweep()
        kept.append(walks.theta.copy())
        sigmas.append(walks.sigma.copy())
        of_ways.append(np.sqrt(walks.within) * walks.sigma)
    theta = np.stack(kept)  # (sweeps, unknowns, walks)
    centre = np.mean(theta, axis=(0, 2))
    off = theta - centre[:, None]
    spread = np.einsum("sic,sjc->ij", off, off) / (off.shape[0] * off.shape[2])
    between = np.var(np.mean(off, axis=0), axis=1)
    effective = walks.count * float(np.min(np.diag(spread) / np.maximum(between, 1e-300)))
    sigma, of_way = (float(np.sqrt(np.mean(np.square(all_)))) for all_ in (sigmas, of_ways))
    noise_found = Noise(sigma, of_way, float(np.std(np.log(of_ways))))
    return Posterior(walks.origin + centre, spread, noise_found, effective)
