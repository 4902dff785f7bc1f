"""Least-squares windows that end now: how far back the belt has moved like a line, or like a parabola.

Grow the window while the residual stays under 0.95 count. That bound alone lets a slow
bend pass that 0.6 s of forecast makes visible, so the means of blocks of the residual are held to what noise
can do as well.
"""

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from math import sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cell.poses import Array

_MOST = 0.95  # counts; rounding leaves 0.5, the rest is room for the fit
_QUANTUM = 12.0**-0.5
_SIGMAS, _SIGMAS_OLD = 3.5, 4.5  # of the newest frames, in which a change shows, and of the many others
_NEW = 30  # frames
_SMALLEST = (5, 7)  # frames for a line and for a parabola
_GROWTH = 1.4
_NEWEST = 8  # frames
_UNKNOWN = 1e12  # counts^2
_SINGULAR = 1e-13  # of a determinant of numbers about 1


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
        return _MOST + _most_sigmas(k) * sqrt(max(self.sigma**2 - _QUANTUM**2, 0.0))

    def passes(self, residual: Array, speed: float, each: int = 1) -> bool:
        """``residual`` (k,), oldest first, counts, of means of ``each`` frames at ``speed`` (counts/s)."""
        k = len(residual)
        beyond = np.abs(residual) > self.most(k)
        if np.count_nonzero(beyond) > 0.005 * k or np.count_nonzero(beyond[-8:]) > 1:
            return False
        blocks = _blocks(k, each)
        sums = np.add.reduceat(residual[::-1][: blocks.end], blocks.begins).tolist() if blocks.end else ()
        step = speed * self.period
        beat = 3.0 * abs(step - round(step))  # counts by which the rounding shifts from frame to frame
        noise = self.patience * self.sigma
        for total, size, frames, sigmas in zip(sums, blocks.sizes, blocks.frames, blocks.sigmas, strict=True):
            # Noise, and rounding that keeps step with the frames.
            if abs(total) / size > sigmas * noise + 0.5 / max(1.0, beat * frames):
                return False
        return True


@dataclass(frozen=True)
class _Blocks:
    """Blocks of k residuals, newest first: where each begins, the ``end`` of the last one, residuals and
    frames in each, and how many standard deviations of a count its mean can be."""

    begins: NDArray[np.intp]
    end: int
    sizes: list[int]
    frames: list[int]
    sigmas: list[float]


@lru_cache(1024)
def _blocks(k: int, each: int) -> _Blocks:
    """Blocks of 4, 8, 16, ... residuals, none much longer than a sixth of all, as far as they are whole."""
    begins, sizes, begin, size = list[int](), list[int](), 0, 4
    while begin + size <= k:
        begins.append(begin)
        sizes.append(size)
        begin, size = begin + size, min(2 * size, max(4, k // 6))
    usual = [_SIGMAS if at * each < _NEW else _SIGMAS_OLD for at in begins]
    frames = [size * each for size in sizes]
    sigmas = [most / sqrt(count) for most, count in zip(usual, frames, strict=True)]
    return _Blocks(np.array(begins, dtype=np.intp), begin, sizes, frames, sigmas)


@lru_cache
def _most_sigmas(k: int) -> float:
    """How many standard deviations the largest of k residuals can be away."""
    return float(3.0 + np.sqrt(2.0 * np.log(max(k, 2))))


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


class Tail:
    """Counts ``n`` (k,) at ``s`` (k,) <= 0 in seconds, for windows of any length that end with the last."""

    def __init__(self, s: Array, n: Array, judge: Judge) -> None:
        self._s, self._judge = s, judge
        self._scale, self._origin = max(-float(s[0]), 1e-9), float(n[-1])
        # 1, u, u^2 and y: all that a window needs of its frames are sums of products of two of these.
        self._rows = np.empty((4, len(s)))
        one, u, square, y = self._rows
        one[:] = 1.0
        np.divide(s, self._scale, out=u)
        np.multiply(u, u, out=square)
        np.subtract(n, self._origin, out=y)

    def longest(self, order: int) -> Window:
        """The longest window over which a polynomial of ``order`` (1 or 2) is the motion.

        Fewer than four frames give a line whatever the order.
        """
        size = len(self._s)
        order = min(order, max(size - 2, 1))
        whole = self._fit(size, order, self._whole)
        if whole.ok:
            return self._window(whole)
        frames = min(_SMALLEST[order - 1], size)
        sums = self._sums(-frames, None)
        best = self._fit(frames, order, sums)
        while best.ok and frames < size:
            before, frames = frames, min(int(frames * _GROWTH) + 1, size)
            sums = sums + self._sums(-frames, -before)
            wider = self._fit(frames, order, sums) if frames < size else whole
            if not wider.ok:
                break
            best = wider
        return self._window(best)

    def steady(self, since: float, sigma: float) -> Window:
        """The line over all frames from ``since`` (s) on, whether or not it is the motion; its speed is known
        to ``sigma`` (counts/s) at best."""
        frames = max(int(np.count_nonzero(self._s >= since)), min(_SMALLEST[0], len(self._s)))
        line = self._window(self._fit(frames, 1, self._sums(-frames, None)))
        return replace(line, cov=line.cov + np.diag([0.0, sigma**2]))

    @cached_property
    def _whole(self) -> Array:
        return self._sums(None, None)

    def _sums(self, begin: int | None, end: int | None) -> Array:
        """(4, 4): of the products of two rows, over the frames from ``begin`` to ``end``."""
        rows = self._rows[:, begin:end]
        out: Array = rows @ rows.T
        return out

    def _fit(self, frames: int, order: int, sums: Array) -> "_Fit":
        """The polynomial through the newest ``frames``, whose ``sums`` (4, 4) are these."""
        length = max(-float(self._rows[1, -frames]), 1e-9)
        solved = _solved(sums, order, length)
        if solved is None:  # frames of a burst may carry one stamp: a place and no speed
            return _Fit((0.0,) * (order + 1), None, frames, length, False)
        c, inverse = solved
        residual = np.array((*(-x for x in c), *(0.0,) * (2 - order), 1.0)) @ self._rows[:, -frames:]
        ok = self._judge.passes(residual, c[1] / self._scale)
        return _Fit(c, inverse, frames, length, ok)

    def _window(self, fit: "_Fit") -> Window:
        length = -float(self._s[-fit.frames])
        c = [x / self._scale**p for p, x in enumerate(fit.c)]
        c[0] += self._origin
        if fit.inverse is None:
            return Window(np.array(c), np.eye(len(c)) * _UNKNOWN, fit.frames, length, fit.ok)
        d = [self._judge.sigma / (fit.length * self._scale) ** p for p in range(len(c))]
        cov = [[x * d[i] * d[j] for j, x in enumerate(row)] for i, row in enumerate(fit.inverse)]
        return Window(np.array(c), np.array(cov), fit.frames, length, fit.ok)


class _Fit(NamedTuple):
    """A polynomial of u; ``inverse`` of its normal matrix with u in lengths of the window, None without."""

    c: tuple[float, ...]
    inverse: tuple[tuple[float, ...], ...] | None
    frames: int
    length: float
    ok: bool


def _solved(
    sums: Array, order: int, length: float
) -> tuple[tuple[float, ...], tuple[tuple[float, ...], ...]] | None:
    """Coefficients by u and the inverse of the normal matrix with u in ``length``; None where it has none.

    By cofactors of numbers of about the same size: a library's call takes longer than all of it.
    """
    (k, p1, p2, y0), (_, _, p3, y1), (_, _, p4, y2), _ = sums.tolist()
    a, b, y1 = p1 / length, p2 / length**2, y1 / length
    if order == 1:
        det = k * b - a * a
        if det <= _SINGULAR * k * k:
            return None
        inverse = (b / det, -a / det), (-a / det, k / det)
        c0, c1 = (row[0] * y0 + row[1] * y1 for row in inverse)
        return (c0, c1 / length), inverse
    c, d, y2 = p3 / length**3, p4 / length**4, y2 / length**2
    kk, ka, kb, aa, ab, bb = (
        b * d - c * c,
        b * c - a * d,
        a * c - b * b,
        k * d - b * b,
        a * b - k * c,
        k * b - a * a,
    )
    det = k * kk + a * ka + b * kb
    if det <= _SINGULAR * k**3:
        return None
    kk, ka, kb, aa, ab, bb = (x / det for x in (kk, ka, kb, aa, ab, bb))
    rows = (kk, ka, kb), (ka, aa, ab), (kb, ab, bb)
    c0, c1, c2 = (row[0] * y0 + row[1] * y1 + row[2] * y2 for row in rows)
    return (c0, c1 / length, c2 / length**2), rows


def line_and_bend(s: Array, n: Array, judge: Judge) -> tuple[Window, Window]:
    """The longest line and the longest parabola; a line through all frames is both."""
    tail = Tail(s, n, judge)
    line = tail.longest(1)
    return line, line if line.ok and line.frames == len(s) else tail.longest(2)


def newest_strays(s: Array, n: Array, judge: Judge) -> NDArray[np.bool_]:
    """Which of the newest counts lie apart from the motion before them, though others beside them do not.

    A belt that starts leaves its motion for good and by little at first; a frame that was swapped or lost
    its number is off by about what the belt moves in a period.
    """
    found = np.zeros(len(s), dtype=bool)
    old = len(s) - _NEWEST
    if old < 3 * _NEWEST:
        return found
    before = max(line_and_bend(s[:old], n[:old], judge), key=lambda w: w.length)
    if not before.ok or before.frames < 3 * _NEWEST:
        return found
    off = np.abs(n[old:] - np.stack([s[old:] ** p for p in range(len(before.c))], axis=1) @ before.c)
    apart = off > np.maximum(judge.most(_NEWEST), 0.4 * abs(float(before.c[1])) * judge.period)
    if apart.sum() <= 3 and not apart[-2:].all() and np.all(off[~apart] <= judge.most(_NEWEST)):
        found[old:] = apart
    return found
