"""Mean and covariance under the likelihood of intervals.

Each edge is somewhere in its interval with equal probability, but for a little normal noise. Most of that
is the arm's, which is off by nearly the same at both edges of a way: a share of the noise's variance, which
is not known, is an offset ``w`` of the way, the rest is the edge's own. Polls often come at the same phase
of both edges, as a chord takes as long in every way, and two edges that were taken one by one would then
tell the same thing twice. With ``w`` held the likelihood of an edge is ``Phi((high - u)/s) - Phi((low -
u)/s)``. That is a polytope with soft faces, narrow and with corners, which no normal proposal fits; so it
is walked through. Beside each edge's ``u`` stands where the input was seen to change, ``y = u + w - s z``,
which lies in the interval, ``z`` being the noise of its own. The steps are exact draws:

- ``y`` with ``u`` and ``w`` held: a normal cut off at the interval's ends;
- the unknowns with all ``y`` held: normal, as in least squares of edges that are off together, and then
  ``w``. That goes far where noise is large;
- the unknowns with all ``w`` and ``z`` held, along a line: even between the ends that the intervals leave.
  That goes far where noise is small.

Source of the pair of the last two: Yu and Meng, "To center or not to center" (2011); of the walk along
lines: Smith, "Efficient Monte Carlo procedures" (1984). The noise is unknown as well and takes its own step,
with ``y`` left open (Metropolis), once with ``w`` held and once with ``w`` in units of the noise, and so does
the edges' own share of it. Many walks
go side by side from points that are spread as averaging says; their mean is what it would be after any number
of sweeps to a tenth of a standard deviation. Random numbers are the same in every call.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from calibration.tool_frame.averaging import AveragingFit, design
from calibration.tool_frame.bounds import LateralModel, Rows
from calibration.tool_frame.repeatability import USUAL_WAY_M
from cell.poses import Array

MIN_SIGMA_M = 2e-7
# Of the noise's variance, common to the edges of a way. An arm that is off by ``a`` at one standstill and by
# ``b`` at the next is off by a blend of both between them: at a third and two thirds of the way 0.8. One that
# goes all the way beside its path by the same: 1. ``WITHIN`` where the noise is known, and to begin with.
SHARES = np.array([0.5, 0.7, 0.8, 0.9, 0.95, 0.98, 0.995, 0.999, 0.9998])
WITHIN = 0.9
_SEED = 20011
_SETTLE = 60  # sweeps until the start is forgotten; more change nothing
_ADAPT = (3, 6, 10, 15, 20, 30)  # after these the lines' directions are those of the walks' own spread
_KEEP = 24  # sweeps that count, worth two or three independent ones
_WALKS_PER_UNKNOWN = 2  # at least, for directions that can be told
_BEGIN = 0.03  # of the widths: noise at the start
_STEP = 1.2  # of the logarithm of the noise
_STEP_HELD = 1.7  # the same, where n offsets are held, which know it to 1/sqrt(2 n): by sqrt(n)
_PLACE_SD_M = 10.0  # of an edge's place, before anything is seen
_FAR = 36.0
_POINTS_OF_NOISE = 101


@dataclass(frozen=True)
class Noise:
    """What single edges scatter by, with what they have in common with their way.

    ``sigma`` (m) is the root of its mean square, and ``spread`` the standard deviation of its logarithm;
    ``spread_before`` that before any data. ``within`` of its variance is common to a way.
    """

    sigma: float
    spread: float
    spread_before: float
    within: float = WITHIN


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
) -> Posterior:
    """``start`` is the solution by averaging, ``noise`` (m) what it shows beyond the intervals' widths.

    About ``points`` places are averaged: a few hundred do for the mean, but 1500 and more for a covariance,
    which with few edges hangs on how seldom there is much noise. ``known_noise`` (m) when the noise need not
    be found, ``usual_noise`` (m) what half of all arms of this kind stay below.
    """
    least = _WALKS_PER_UNKNOWN * (rows.X.shape[1] + len(rows.labels))
    walks = _Walks(rows, model, start, noise, max(points // _KEEP, least), known_noise, usual_noise)
    for sweep in range(_SETTLE):
        walks.sweep()
        if sweep in _ADAPT:
            walks.adapt()
    kept, sigmas, shares = [], [], []
    for _ in range(_KEEP):
        walks.sweep()
        kept.append(walks.theta.copy())
        sigmas.append(walks.sigma.copy())
        shares.append(walks.within)
    theta = np.stack(kept)  # (sweeps, unknowns, walks)
    centre = np.mean(theta, axis=(0, 2))
    off = theta - centre[:, None]
    spread = np.einsum("sic,sjc->ij", off, off) / (off.shape[0] * off.shape[2])
    between = np.var(np.mean(off, axis=0), axis=1)
    effective = walks.count * float(np.min(np.diag(spread) / np.maximum(between, 1e-300)))
    sigma = float(np.sqrt(np.mean(np.square(sigmas))))
    within = float(np.sum(np.square(sigmas) * shares) / np.sum(np.square(sigmas)))
    noise_found = Noise(sigma, float(np.std(np.log(sigmas))), walks.noise_spread(), within)
    return Posterior(walks.origin + centre, spread, noise_found, effective)


class _Walks:
    """``count`` walks side by side: ``theta`` (d + m, count) are the unknowns and the edges' places counted
    from ``origin``, ``sigma`` (count,) m the noise. Widths are those of the intervals."""

    def __init__(
        self,
        rows: Rows,
        model: LateralModel,
        start: AveragingFit,
        noise: float,
        count: int,
        known: float | None,
        usual: float,
    ) -> None:
        self.rng = np.random.default_rng(_SEED)
        self.count = count
        self.A = design(rows)
        self.squares = (self.A[:, :, None] * self.A[:, None, :]).reshape(len(self.A), -1)
        self.origin = np.concatenate([start.psi, start.e])
        self.low = (rows.low - self.A @ self.origin)[:, None]
        self.high = self.low + rows.width[:, None]
        self.soft2 = rows.soft[:, None] ** 2
        sources, self.way = np.unique(rows.source, return_inverse=True)
        self.of_way = (np.arange(len(sources))[:, None] == self.way).astype(float)
        self.together = np.zeros((len(sources), count))  # ``w`` of each way
        self.share = np.full(count, int(np.argmax(SHARES == WITHIN)))
        self.width = float(np.median(rows.width))
        self.least = max(0.008 * self.width, MIN_SIGMA_M)
        self.most = max(0.5 * self.width, 2.0 * noise, 4.0 * MIN_SIGMA_M)
        self.known, self.usual = known, usual
        self.precision = 1.0 / np.concatenate([model.prior_sd, np.full(len(start.e), _PLACE_SD_M)]) ** 2
        self.trusted = np.flatnonzero(np.isfinite(model.trust))
        self.trust = model.trust[self.trusted][:, None]
        self.root = _root(start.cov)
        self.theta = self.root @ self.rng.standard_normal((len(self.origin), count))
        # Much noise is easy to believe in and hard to get rid of; little is the other way round.
        begin = max(_BEGIN * self.width, noise, known or 0.0)
        self.sigma = np.full(count, min(begin, self.most) if known is None else begin)
        self.prior = np.repeat(self.precision[:, None], count, axis=1)

    def sweep(self) -> None:
        """Each unknown moves, along each of as many lines as there are unknowns."""
        self._trust()
        u = self.A @ self.theta
        if self.known is None:
            self._noise(u)
        elif self.sigma[0] > self.known:
            smaller = np.maximum(0.6 * self.sigma, self.known)
            self.together *= smaller / self.sigma
            self.sigma = smaller
        s, y = self._seen(u)
        self._all(y, s)
        self._lines(y)

    def adapt(self) -> None:
        """Take the lines' directions from how the walks are spread now."""
        self.root = _root(np.cov(self.theta))

    def _trust(self) -> None:
        """A Cauchy prior is normal with a precision of its own, which is drawn: exponential."""
        if len(self.trusted):
            x = (self.origin[self.trusted][:, None] + self.theta[self.trusted]) / self.trust
            scale = self.rng.exponential(size=x.shape) * 2.0 / (1.0 + x**2)
            self.prior[self.trusted] = self.precision[self.trusted][:, None] + scale / self.trust**2

    @property
    def within(self) -> Array:
        """(count,) of the noise's variance, common to a way."""
        found: Array = SHARES[self.share]
        return found

    def _noise(self, u: Array) -> None:
        """Noise and the ways' share of it with the places of change left open, in three steps."""
        log = self._log_chance(u, self.sigma, self.together, self.share)
        # All noise, with the ways' offsets as they are.
        ways = len(self.together)
        scale = np.exp(_STEP_HELD / np.sqrt(ways) * self.rng.standard_normal(self.count))
        squares = np.sum(self.together**2, axis=0) / (self.within * self.sigma**2)
        gain = 0.5 * squares * (1.0 - scale**-2) - ways * np.log(scale)
        log = self._metropolis(u, log, gain, scale * self.sigma, self.together, self.share)
        # The edges' own alone: the ways' stays what it was.
        share = self.share + self.rng.choice((-1, 1), self.count)
        gain = np.where((share >= 0) & (share < len(SHARES)), 0.0, -np.inf)
        share = np.clip(share, 0, len(SHARES) - 1)
        sigma = self.sigma * np.sqrt(self.within / SHARES[share])
        log = self._metropolis(u, log, gain, sigma, self.together, share)
        # All noise, with the ways' offsets in units of it.
        scale = np.exp(_STEP * self.rng.standard_normal(self.count))
        self._metropolis(u, log, 0.0, scale * self.sigma, scale * self.together, self.share)

    def _metropolis(
        self,
        u: Array,
        log: Array,
        gain: Array | float,
        sigma: Array,
        together: Array,
        share: NDArray[np.int64],
    ) -> Array:
        """Take the noise ``sigma``, the ways' offsets ``together`` and the ``share`` where these are likely
        enough beside those of now, whose likelihood is ``log``; the new ``log``. ``gain`` is what the priors
        of the last two add."""
        inside = (sigma >= self.least) & (sigma <= self.most)
        then = self._log_chance(u, sigma, together, share)
        gain = gain + then - log + self._noise_prior(sigma) - self._noise_prior(self.sigma)
        take = (np.log(self.rng.random(self.count)) < gain) & inside
        self.sigma = np.where(take, sigma, self.sigma)
        self.together = np.where(take, together, self.together)
        self.share = np.where(take, share, self.share)
        return np.where(take, then, log)

    def _log_chance(self, u: Array, sigma: Array, together: Array, share: NDArray[np.int64]) -> Array:
        """(count,) logarithm of how likely the intervals are."""
        a, b, _, _ = self._cut(u + together[self.way], sigma, SHARES[share])
        found: Array = np.sum(np.log(np.maximum(b - a, 1e-300)), axis=0)
        return found

    def _seen(self, u: Array) -> tuple[Array, Array]:
        """Each edge's own noise and where its change was seen; (n, count) each."""
        centre = u + self.together[self.way]
        a, b, mirrored, s = self._cut(centre, self.sigma, self.within)
        z = ndtri(_within(a + (b - a) * self.rng.random(a.shape), 1e-300, 1.0 - 1e-16))
        z *= s
        return s, _within(centre + np.where(mirrored, -z, z), self.low, self.high)

    def _cut(
        self, centre: Array, sigma: Array, within: Array
    ) -> tuple[Array, Array, NDArray[np.bool_], Array]:
        """The normal distribution about ``centre`` at both ends of the intervals, mirrored into the lower
        tail; where it is mirrored; and ``s``."""
        s = np.sqrt(self.soft2 + (1.0 - within) * sigma**2)
        low, high = (self.low - centre) / s, (self.high - centre) / s
        mirrored = low + high > 0.0
        first, second = np.where(mirrored, -high, low), np.where(mirrored, -low, high)
        return ndtr(np.maximum(first, -_FAR - 1.0)), ndtr(np.maximum(second, -_FAR)), mirrored, s

    def _noise_prior(self, sigma: Array) -> Array:
        """Logarithm of how likely ``log sigma`` is before the data: a half-Cauchy (Gelman 2006) with
        what is usual in its middle. Few edges neither show noise nor that there is none."""
        found: Array = np.log(sigma) - np.log1p((sigma / self.usual) ** 2)
        return found

    def noise_spread(self) -> float:
        """Standard deviation of the logarithm of the noise before any data."""
        log = np.linspace(np.log(self.least), np.log(self.most), _POINTS_OF_NOISE)
        weight = np.exp(self._noise_prior(np.exp(log)))
        return float(np.sqrt(np.cov(log, aweights=weight)))

    def _all(self, y: Array, s: Array) -> None:
        """All unknowns at once with the places of change held, whatever the ways' offsets are; then these."""
        p = len(self.origin)
        weight = 1.0 / s**2
        own = weight.T[:, :, None] * self.A  # (count, n, p)
        of_ways = self.of_way @ own
        known = 1.0 / (self.of_way @ weight + 1.0 / (self.within * self.sigma**2))  # variance of each offset
        shared = of_ways * known.T[:, :, None]
        normal = (weight.T @ self.squares).reshape(self.count, p, p)
        normal -= shared.transpose(0, 2, 1) @ of_ways
        normal[:, np.arange(p), np.arange(p)] += self.prior.T
        right = (self.A.T @ (weight * y) - self.prior * self.origin[:, None]).T
        right -= np.einsum("cwp,wc->cp", shared, self.of_way @ (weight * y))
        scale = 1.0 / np.sqrt(np.einsum("cii->ci", normal))
        root = np.linalg.cholesky(normal * scale[:, :, None] * scale[:, None, :])
        half = np.linalg.solve(root, (scale * right)[..., None])
        half += self.rng.standard_normal(half.shape)
        self.theta = (scale * np.linalg.solve(root.transpose(0, 2, 1), half)[..., 0]).T
        mean = known * (self.of_way @ (weight * (y - self.A @ self.theta)))
        self.together = mean + np.sqrt(known) * self.rng.standard_normal(known.shape)

    def _lines(self, y: Array) -> None:
        """Along one line after the other, with the noise of each edge held: ``y`` moves with the unknowns."""
        turn, _ = np.linalg.qr(self.rng.standard_normal(self.root.shape))
        directions = self.root @ turn
        steps = self.A @ directions
        room = np.stack([self.high - y, y - self.low])  # above and below where each edge's change was seen
        width, edges = self.high - self.low, np.arange(len(steps))
        size = np.abs(steps)
        felt = size > 1e-9 * np.max(size, axis=0)
        inverse = 1.0 / np.where(felt, size, 1.0)
        all_felt = felt.all(axis=0).tolist()
        against = (steps < 0.0).astype(np.intp)
        for k, (direction, step) in enumerate(zip(directions.T, steps.T, strict=True)):
            ahead, behind = room[against[:, k], edges], room[1 - against[:, k], edges]
            ahead *= inverse[:, k, None]
            behind *= inverse[:, k, None]
            if not all_felt[k]:
                ahead[~felt[:, k]] = behind[~felt[:, k]] = np.inf
            t = self._on_line(direction, -behind.min(axis=0), ahead.min(axis=0))
            self.theta += direction[:, None] * t
            above, below = room
            above -= step[:, None] * t
            np.minimum(np.maximum(above, 0.0, out=above), width, out=above)
            np.subtract(width, above, out=below)

    def _on_line(self, direction: Array, bottom: Array, top: Array) -> Array:
        """(count,) how far along the line: even between both ends, but for the prior."""
        t = bottom + (top - bottom) * self.rng.random(self.count)
        here, there = self.origin[:, None] + self.theta, direction[:, None] * t
        gain = -0.5 * self.precision @ (there * (2.0 * here + there))
        if len(self.trusted):
            old = here[self.trusted] / self.trust
            new = old + there[self.trusted] / self.trust
            gain += np.sum(np.log1p(old**2) - np.log1p(new**2), axis=0)
        return np.where(np.log(self.rng.random(self.count)) < gain, t, 0.0)


def _within(x: Array, low: Array | float, high: Array | float) -> Array:
    """``x`` between the bounds; NumPy's clip takes three times as long."""
    out: Array = np.minimum(np.maximum(x, low), high)
    return out


def _root(cov: Array) -> Array:
    scale = np.sqrt(np.diag(cov))
    found: Array = scale[:, None] * np.linalg.cholesky(cov / np.outer(scale, scale) + 1e-9 * np.eye(len(cov)))
    return found
