"""Least-squares windows that end now: how far back the belt has moved like a line, or like a parabola.

Grow the window while the residual stays under 0.95 count. That bound alone lets a slow
bend pass that 0.6 s of forecast makes visible, so the means of blocks of the residual are held to what noise
can do as well.
"""

from dataclasses import dataclass
from functools import lru_cache
from math import sqrt

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dgesv

from cell.poses import Array

_MOST = 0.95  # counts; rounding leaves 0.5, the rest is room for the fit
_QUANTUM = 12.0**-0.5
_SIGMAS, _SIGMAS_OLD = 3.5, 4.5  # of the newest frames, in which a change shows, and of the many others
_NEW = 30  # frames
_SMALLEST = (5, 7)  # frames for a line and for a parabola
_GROWTH = 1.4
_NEWEST = 8  # frames
_UNKNOWN = 1e12  # counts^2


@dataclass(frozen=True)
class Judge:
    """Whether residuals are noise. ``sigma`` of one count in counts, ``period`` of the frames in s.

    ``patience`` widens what the means of blocks may be.
    """

    sigma: float
    period: float
    patience: float = 1.0

    def most(self, k: int) -> float:
        """What the largest of k residuals can be, counts."""
        jitter = np.sqrt(max(self.sigma**2 - _QUANTUM**2, 0.0))
        return float(_MOST + _most_sigmas(k) * jitter)

    def passes(self, residual: Array, speed: float, each: int = 1) -> bool:
        """``residual`` (k,), oldest first, counts, of means of ``each`` frames at ``speed`` (counts/s)."""
        k = len(residual)
        beyond = np.abs(residual) > self.most(k)
        if np.count_nonzero(beyond) > 0.005 * k or np.count_nonzero(beyond[-8:]) > 1:
            return False
        total = np.cumsum(residual[::-1])
        step = speed * self.period
        beat = abs(step - round(step))  # counts by which the rounding shifts from frame to frame
        before, size, begin = 0.0, 4, 0
        while begin + size <= k:
            up_to = float(total[begin + size - 1])
            sigmas = self.patience * (_SIGMAS if begin * each < _NEW else _SIGMAS_OLD)
            if abs(up_to - before) / size > self._mean_limit(size * each, beat, sigmas):
                return False
            before, begin, size = up_to, begin + size, min(2 * size, max(4, k // 6))
        return True

    def _mean_limit(self, frames: int, beat: float, sigmas: float) -> float:
        """What the mean of so many residuals can be: noise, and rounding that keeps step with the frames."""
        return sigmas * self.sigma / sqrt(frames) + 0.5 / max(1.0, 3.0 * beat * frames)


@lru_cache
def _most_sigmas(k: int) -> float:
    """How many standard deviations the largest of k residuals can be away."""
    return float(3.0 + np.sqrt(2.0 * np.log(max(k, 2))))


@lru_cache
def _unit(n: int) -> Array:
    return np.eye(n)


@dataclass(frozen=True)
class Window:
    """A polynomial over the last ``frames``: position (counts) at ``now + s`` is ``c0 + c1 s (+ c2 s^2)``.

    ``cov`` is that of the coefficients for noise of ``sigma`` counts; ``length`` in s; ``ok`` whether the
    residual is noise.
    """

    c: Array
    cov: Array
    frames: int
    length: float
    ok: bool

    @property
    def order(self) -> int:
        return len(self.c) - 1


def polynomial(s: Array, n: Array, order: int, sigma: float) -> tuple[Array, Array, Array]:
    """Coefficients, covariance and residual of ``n`` (k,) over ``s`` (k,), s <= 0 in seconds."""
    scale = max(-float(s[0]), 1e-9)
    V = np.empty((len(s), order + 1))
    V[:, 0] = 1.0
    np.divide(s, scale, out=V[:, 1])
    for p in range(2, order + 1):
        np.multiply(V[:, p - 1], V[:, 1], out=V[:, p])
    # What NumPy's inv calls too, which looks at much before it.
    _, _, columns, singular = dgesv(V.T @ V, _unit(order + 1))
    if singular:
        raise np.linalg.LinAlgError("Singular matrix")
    inverse = np.ascontiguousarray(columns)
    c = inverse @ (n @ V)
    d = scale ** -np.arange(order + 1.0)
    return d * c, sigma**2 * d * inverse * d[:, None], n - V @ c


def longest(s: Array, n: Array, order: int, judge: Judge) -> Window:
    """The longest window ending at the newest frame over which a polynomial of ``order`` is the motion.

    Fewer than four frames give a line whatever the order.
    """
    order = min(order, max(len(s) - 2, 1))
    whole = _window(s, n, len(s), order, judge)
    if whole.ok:
        return whole
    frames = min(_SMALLEST[order - 1], len(s))
    best = _window(s, n, frames, order, judge)
    while best.ok and frames < len(s):
        frames = min(int(frames * _GROWTH) + 1, len(s))
        wider = _window(s, n, frames, order, judge) if frames < len(s) else whole
        if not wider.ok:
            break
        best = wider
    return best


def _window(s: Array, n: Array, frames: int, order: int, judge: Judge) -> Window:
    try:
        c, cov, residual = polynomial(s[-frames:], n[-frames:], order, judge.sigma)
    except np.linalg.LinAlgError:  # frames of a burst may carry one stamp: a place and no speed
        c, cov = np.zeros(order + 1), np.eye(order + 1) * _UNKNOWN
        c[0] = n[-1]
        return Window(c, cov, frames, -float(s[-frames]), False)
    return Window(c, cov, frames, -float(s[-frames]), judge.passes(residual, float(c[1])))


def newest_strays(s: Array, n: Array, judge: Judge) -> NDArray[np.bool_]:
    """Which of the newest counts lie apart from the motion before them, though others beside them do not.

    A belt that starts leaves its motion for good and by little at first; a frame that was swapped or lost
    its number is off by about what the belt moves in a period.
    """
    found = np.zeros(len(s), dtype=bool)
    old = len(s) - _NEWEST
    if old < 3 * _NEWEST:
        return found
    before = max((longest(s[:old], n[:old], p, judge) for p in (1, 2)), key=lambda w: w.length)
    if not before.ok or before.frames < 3 * _NEWEST:
        return found
    off = np.abs(n[old:] - np.stack([s[old:] ** p for p in range(len(before.c))], axis=1) @ before.c)
    apart = off > np.maximum(judge.most(_NEWEST), 0.4 * abs(float(before.c[1])) * judge.period)
    if apart.sum() <= 3 and not apart[-2:].all() and np.all(off[~apart] <= judge.most(_NEWEST)):
        found[old:] = apart
    return found
