"""The walks of :mod:`calibration.tool_frame.posterior`, which says what they do and why."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solveh_banded
from scipy.special import ndtr, ndtri

from calibration.tool_frame.averaging import AveragingFit, design
from calibration.tool_frame.bounds import LateralModel, Rows
from calibration.tool_frame.standstills import WITHIN, alternating, of_standstills
from cell.poses import Array

MIN_SIGMA_M = 2e-7
# Of the noise's variance, common to the edges of a way. An arm that is off by ``a`` at one standstill and by
# ``b`` at the next is off by a blend of both between them: at a third and two thirds of the way 0.8. One that
# goes all the way beside its path by the same: 1.
SHARES = np.array([0.5, 0.7, 0.8, 0.9, 0.95, 0.98, 0.995, 0.999, 0.9998])
_SEED = 20011
_BEGIN = 0.03  # of the widths: noise at the start
_STEP = 1.2  # of the logarithm of the noise
_STEP_HELD = 1.7  # the same, where n offsets are held, which know it to 1/sqrt(2 n): by sqrt(n)
_PLACE_SD_M = 10.0  # of an edge's place, before anything is seen
_FAR = 36.0


class Walks:
    """``count`` walks side by side: ``theta`` (d + m, count) are the unknowns and the edges' places counted
    from ``origin``, ``sigma`` (count,) m the noise, ``stands`` (q, count) what the arm is off by at each
    standstill, in units of a way's offset. Widths are those of the intervals."""

    def __init__(
        self,
        rows: Rows,
        model: LateralModel,
        start: AveragingFit,
        noise: float,
        count: int,
        known: float | None,
        usual: float,
        neighbours: Sequence[tuple[int, int]],
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
        self.edges_of_way, _ = _padded(self.of_way)
        self.of_stand = of_standstills(sources.tolist(), neighbours)
        self.edges_of_stand, share = _padded(self.of_stand[self.way].T)
        self.A_of_stand = share[:, :, None] * self.A[self.edges_of_stand]
        self.colours = [_Colour.of(self.of_stand, own) for own in alternating(self.of_stand)]
        self.stands = np.zeros((self.of_stand.shape[1], count))
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
            self.stands *= smaller / self.sigma
            self.sigma = smaller
        s, y = self._seen(u)
        self._all(y, s)
        self._stand_by_stand(y)
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
        log = self._log_chance(u, self.sigma, self.stands, self.share)
        # All noise, with the ways' offsets as they are.
        stands = len(self.stands)
        scale = np.exp(_STEP_HELD / np.sqrt(stands) * self.rng.standard_normal(self.count))
        squares = np.sum(self.stands**2, axis=0) / (self.within * self.sigma**2)
        gain = 0.5 * squares * (1.0 - scale**-2) - stands * np.log(scale)
        log = self._metropolis(u, log, gain, scale * self.sigma, self.stands, self.share)
        # The edges' own alone: the ways' stays what it was.
        share = self.share + self.rng.choice((-1, 1), self.count)
        gain = np.where((share >= 0) & (share < len(SHARES)), 0.0, -np.inf)
        share = np.clip(share, 0, len(SHARES) - 1)
        sigma = self.sigma * np.sqrt(self.within / SHARES[share])
        log = self._metropolis(u, log, gain, sigma, self.stands, share)
        # All noise, with the ways' offsets in units of it.
        scale = np.exp(_STEP * self.rng.standard_normal(self.count))
        self._metropolis(u, log, 0.0, scale * self.sigma, scale * self.stands, self.share)

    def _metropolis(
        self,
        u: Array,
        log: Array,
        gain: Array | float,
        sigma: Array,
        stands: Array,
        share: NDArray[np.int64],
    ) -> Array:
        """Take the noise ``sigma``, the ``stands`` and the ``share`` where these are likely
        enough beside those of now, whose likelihood is ``log``; the new ``log``. ``gain`` is what the priors
        of the last two add."""
        inside = (sigma >= self.least) & (sigma <= self.most)
        then = self._log_chance(u, sigma, stands, share)
        gain = gain + then - log + self._noise_prior(sigma) - self._noise_prior(self.sigma)
        take = (np.log(self.rng.random(self.count)) < gain) & inside
        self.sigma = np.where(take, sigma, self.sigma)
        self.stands = np.where(take, stands, self.stands)
        self.share = np.where(take, share, self.share)
        return np.where(take, then, log)

    def _log_chance(self, u: Array, sigma: Array, stands: Array, share: NDArray[np.int64]) -> Array:
        """(count,) logarithm of how likely the intervals are."""
        s = self._own(sigma, SHARES[share])
        a, b, _ = self._cut(u + self._offsets(stands), s)
        found: Array = np.sum(np.log(np.maximum(b - a, 1e-300)), axis=0)
        return found

    def _seen(self, u: Array) -> tuple[Array, Array]:
        """Each edge's own noise and where its change was seen; (n, count) each."""
        centre, s = u + self._offsets(self.stands), self._own(self.sigma, self.within)
        a, b, mirrored = self._cut(centre, s)
        z = s * _drawn(self.rng, a, b, mirrored)
        return s, _within(centre + z, self.low, self.high)

    def _offsets(self, stands: Array) -> Array:
        """(n, count) what the arm is off by at each edge."""
        found: Array = (self.of_stand @ stands)[self.way]
        return found

    def _own(self, sigma: Array, within: Array) -> Array:
        """(n, count) m of noise that each edge has of its own."""
        return np.sqrt(self.soft2 + (1.0 - within) * sigma**2)

    def _cut(self, centre: Array, s: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
        """What :func:`_tails` says of the intervals, for a normal of ``s`` about ``centre``."""
        return _tails((self.low - centre) / s, (self.high - centre) / s)

    def _noise_prior(self, sigma: Array) -> Array:
        """Logarithm of how likely ``log sigma`` is before the data: a half-Cauchy (Gelman 2006) with
        what is usual in its middle. Few edges neither show noise nor that there is none."""
        found: Array = np.log(sigma) - np.log1p((sigma / self.usual) ** 2)
        return found

    def _all(self, y: Array, s: Array) -> None:
        """All unknowns at once with the places of change held, whatever the standstills are; then these."""
        p, H = len(self.origin), self.of_stand
        weight = 1.0 / s**2
        seen, of_noise = (self.of_way @ weight).T, 1.0 / (self.within * self.sigma**2)
        # The inverse of a precision times a draw that has it as its covariance is a draw from what is known
        # (Papandreou and Yuille 2010).
        draw = (np.sqrt(seen) * self.rng.standard_normal(seen.shape)) @ H
        draw += np.sqrt(of_noise)[:, None] * self.rng.standard_normal(draw.shape)
        right_of_stands = (self.of_way @ (weight * y)).T @ H
        # Walks and standstills come last, as LAPACK takes right sides one after the other.
        both = np.empty((p + 1, self.count, H.shape[1]))
        both[:p] = (self.A_of_stand.transpose(0, 2, 1) @ weight[self.edges_of_stand]).transpose(1, 2, 0)
        both[p] = right_of_stands + draw
        solved = self._over_precision(seen, of_noise, both)
        shared = solved[:p].swapaxes(0, 1)
        normal = (weight.T @ self.squares).reshape(self.count, p, p)
        normal -= shared @ both[:p].transpose(1, 2, 0)
        normal[:, np.arange(p), np.arange(p)] += self.prior.T
        right = (self.A.T @ (weight * y) - self.prior * self.origin[:, None]).T
        right -= (shared @ right_of_stands[:, :, None])[:, :, 0]
        scale = 1.0 / np.sqrt(np.einsum("cii->ci", normal))
        root = np.linalg.cholesky(normal * scale[:, :, None] * scale[:, None, :])
        half = np.linalg.solve(root, (scale * right)[..., None])
        half += self.rng.standard_normal(half.shape)
        self.theta = (scale * np.linalg.solve(root.transpose(0, 2, 1), half)[..., 0]).T
        self.stands = (solved[p] - (self.theta.T[:, None, :] @ shared)[:, 0]).T

    def _over_precision(self, seen: Array, of_noise: Array, right: Array) -> Array:
        """``right`` (k, count, q) divided by the precision of the standstills, which is what the ways tell,
        ``seen`` (count, ways), and of each walk ``of_noise`` (count,). Only standstills next to each other
        have to do with each other, so that all walks are one matrix with two diagonals."""
        H = self.of_stand
        bands = np.zeros((2, self.count, H.shape[1]))
        bands[0] = seen @ H**2 + of_noise[:, None]
        bands[1, :, :-1] = seen @ (H[:, :-1] * H[:, 1:])
        found: Array = solveh_banded(
            bands.reshape(2, -1), right.reshape(len(right), -1).T, lower=True, check_finite=False
        )
        return found.T.reshape(right.shape)

    def _stand_by_stand(self, y: Array) -> None:
        """Each standstill with all else and the noise of each edge held: ``y`` moves with its ways."""
        sigma = np.sqrt(self.within) * self.sigma
        for colour in self.colours:
            least = (self.low - y)[self.edges_of_way].max(axis=1)
            most = (self.high - y)[self.edges_of_way].min(axis=1)
            before = self.stands[colour.stands]
            low, high = ((before + room) / sigma for room in colour.room(least, most))
            then = sigma * _within(_drawn(self.rng, *_tails(low, high)), low, high)
            self.stands[colour.stands] = then
            y += colour.moved(then - before, len(self.of_stand))[self.way]
            np.minimum(np.maximum(y, self.low, out=y), self.high, out=y)

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


@dataclass(frozen=True, eq=False)
class _Colour:
    """Some standstills (k,) no two of which are of one way. ``ways`` (m,) are those that they move, in their
    order, ``share`` (m, 1) how far, ``own`` (m,) which of them does, and ``begin`` (k,) where its ways begin.
    """

    stands: NDArray[np.intp]
    ways: NDArray[np.intp]
    share: Array
    own: NDArray[np.intp]
    begin: NDArray[np.intp]

    @classmethod
    def of(cls, of_stand: Array, stands: Sequence[int]) -> Self:
        places = np.array(stands, dtype=np.intp)
        own, ways = np.nonzero(of_stand[:, places].T)
        share = of_stand[ways, places[own]][:, None]
        return cls(places, ways, share, own, np.searchsorted(own, np.arange(len(places))))

    def room(self, least: Array, most: Array) -> tuple[Array, Array]:
        """How far each may move, (k, count), with ways that may move by ``least`` to ``most``."""
        low = np.maximum.reduceat(least[self.ways] / self.share, self.begin, axis=0)
        return low, np.minimum.reduceat(most[self.ways] / self.share, self.begin, axis=0)

    def moved(self, step: Array, ways: int) -> Array:
        """(``ways``, count) how far all ways go when these go by ``step`` (k, count)."""
        found = np.zeros((ways, step.shape[1]))
        found[self.ways] = self.share * step[self.own]
        return found


def _padded(of: Array) -> tuple[NDArray[np.intp], Array]:
    """(k, most) the columns that each row of ``of`` (k, n) has something in, and what. In a row that has
    fewer than another the first comes again, with 0."""
    most = int(np.max(np.count_nonzero(of, axis=1)))
    places, values = np.zeros((len(of), most), dtype=np.intp), np.zeros((len(of), most))
    for row, place, value in zip(of, places, values, strict=True):
        found = np.flatnonzero(row)
        place[:] = found[0]
        place[: len(found)], value[: len(found)] = found, row[found]
    return places, values


def _tails(low: Array, high: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
    """The normal distribution at both ends of ``low .. high``, mirrored into the lower tail, where it is
    exact; and where it is mirrored."""
    mirrored = low + high > 0.0
    first, second = np.where(mirrored, -high, low), np.where(mirrored, -low, high)
    return ndtr(np.maximum(first, -_FAR - 1.0)), ndtr(np.maximum(second, -_FAR)), mirrored


def _drawn(rng: np.random.Generator, a: Array, b: Array, mirrored: NDArray[np.bool_]) -> Array:
    """A normal number between the ends that :func:`_tails` was asked for."""
    z = ndtri(_within(a + (b - a) * rng.random(a.shape), 1e-300, 1.0 - 1e-16))
    found: Array = np.where(mirrored, -z, z)
    return found


def _within(x: Array, low: Array | float, high: Array | float) -> Array:
    """``x`` between the bounds; NumPy's clip takes three times as long."""
    out: Array = np.minimum(np.maximum(x, low), high)
    return out


def _root(cov: Array) -> Array:
    scale = np.sqrt(np.diag(cov))
    found: Array = scale[:, None] * np.linalg.cholesky(cov / np.outer(scale, scale) + 1e-9 * np.eye(len(cov)))
    return found
