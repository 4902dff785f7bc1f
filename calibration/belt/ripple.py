"""A belt that runs with ripple: a line (or a parabola) and up to three sinusoids, fitted to the counts.

Ripple comes from drums that are out of round and from gears; it keeps its frequency for long. The frequencies
are searched on a grid, one sinusoid after the other, then all parameters are refined together.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from math import cos, sin

import numpy as np

from calibration.belt.fit import Judge
from cell.poses import Array

MOST = 3  # sinusoids
_FINE, _COARSE = 0.02, 0.05  # s; means over so long are fitted, and searched
_FASTEST = 8.0  # Hz
_SLOWEST = 0.55  # periods in the window
_STEP = 0.25  # of the width of a line in the spectrum
_LENGTHS = (12.0, 8.0, 5.0, 3.3, 2.2, 1.4)  # s
_SHORTEST = 1.2
_STEADY = 0.25  # of the speed; a larger change is a stop or a start, not ripple
_WORTH = 12.0  # drop of the Bayesian criterion that an added sinusoid must bring
_PATIENCE = 1.4
_ROUNDS = 8


@dataclass(frozen=True)
class Blocks:
    """Means of ``each`` frames, the last one ending at the newest frame: times, counts, width in s."""

    s: Array
    n: Array
    each: int
    width: float


def blocks(s: Array, n: Array, period: float, width: float) -> Blocks:
    """Block means of about ``width`` seconds; the oldest frames that fill no block are left out."""
    each = max(1, round(width / period))
    k = len(s) // each
    rows = slice(len(s) - k * each, None)
    return Blocks(
        s[rows].reshape(k, each).mean(axis=1), n[rows].reshape(k, each).mean(axis=1), each, each * period
    )


@dataclass(frozen=True)
class Ripple:
    """Position in counts at ``now + s``: ``sum_p c_p s^p + sum_i (a_i cos + b_i sin)(2 pi f_i s)``.

    ``c`` holds the polynomial first, then a, b of each sinusoid; ``f`` in Hz. ``cov`` belongs to (c, f).
    """

    c: Array
    f: Array
    order: int
    cov: Array
    length: float
    ok: bool

    def position(self, s: Array) -> Array:
        """Counts at ``now + s``; s (k,)."""
        return np.asarray(_basis(s, self.f, self.order, 0.0) @ self.c)

    def position_at(self, s: float) -> float:
        """Counts at ``now + s`` for one s."""
        c, waves = self._plain
        return sum(x * s**p for p, x in enumerate(c)) + sum(
            a * cos(w * s) + b * sin(w * s) for a, b, w in waves
        )

    def speed_at(self, s: float) -> float:
        """Counts per second at ``now + s``."""
        c, waves = self._plain
        out = sum(p * x * s ** (p - 1) for p, x in enumerate(c) if p)
        return out + sum(w * (b * cos(w * s) - a * sin(w * s)) for a, b, w in waves)

    @cached_property
    def _plain(self) -> tuple[list[float], list[tuple[float, float, float]]]:
        """The polynomial, and a, b and 2 pi f of each sinusoid."""
        c, n = self.c.tolist(), self.order + 1
        return c[:n], list(zip(c[n::2], c[n + 1 :: 2], (2.0 * np.pi * self.f).tolist(), strict=True))

    def gradient(self, s: Array) -> Array:
        """Derivative of the position by (c, f), shape (k, parameters)."""
        return _with_frequencies(_basis(s, self.f, self.order, 0.0), s, self.order, self.c)


def _basis(s: Array, f: Array, order: int, width: float) -> Array:
    x = 2.0 * np.pi * s[:, None] * f
    damp = _seen(f, width)
    out = np.empty((len(s), order + 1 + 2 * len(f)))
    out[:, 0] = 1.0
    for p in range(1, order + 1):
        np.multiply(out[:, p - 1], s, out=out[:, p])
    np.multiply(np.cos(x), damp, out=out[:, order + 1 :: 2])
    np.multiply(np.sin(x), damp, out=out[:, order + 2 :: 2])
    return out


def _seen(f: Array, width: float) -> Array:
    """How much of sinusoids (k,) in Hz a mean over ``width`` s sees."""
    x = np.pi * f * width
    return np.asarray(np.sin(x) / x) if width > 0.0 else np.ones(len(f))


def _with_frequencies(basis: Array, s: Array, order: int, c: Array) -> Array:
    """The Jacobian by (c, f): ``basis`` and the derivatives by the frequencies."""
    a, b = c[order + 1 :: 2], c[order + 2 :: 2]
    by_f = 2.0 * np.pi * s[:, None] * (basis[:, order + 1 :: 2] * b - basis[:, order + 2 :: 2] * a)
    return np.concatenate([basis, by_f], axis=1)


def steady_length(data: Blocks) -> float:
    """How long the belt has run without stop or start, s."""
    if len(data.s) < 8:
        return 0.0
    speed = np.diff(data.n) / np.diff(data.s)
    now = float(np.mean(speed[-6:]))
    off = np.flatnonzero(np.abs(speed - now) > _STEADY * abs(now) + 3.0 / data.width)
    return -float(data.s[0 if not len(off) else off[-1] + 1])


def search(s: Array, n: Array, judge: Judge) -> Ripple | None:
    """The longest window over which line and sinusoids explain the counts ``n`` (k,) at ``s`` (k,) <= 0."""
    coarse = blocks(s, n, judge.period, _COARSE)
    steady = steady_length(coarse)
    limit = min(steady, -float(s[0]))
    if limit < _SHORTEST:
        return None
    for length in [limit, *(x for x in _LENGTHS if x < 0.9 * limit)]:
        rows = s >= -length
        found = _fit(s[rows], n[rows], coarse, judge)
        if found is not None and found.ok:
            return found
    return None


def _fit(s: Array, n: Array, coarse: Blocks, judge: Judge) -> Ripple | None:
    fine = blocks(s, n, judge.period, _FINE)
    rows = coarse.s >= s[0]
    cs, cn = coarse.s[rows], coarse.n[rows]
    length = -float(s[0])
    if length <= 0.0:  # frames that came at once, after a PC had stood still
        return None
    grid = np.arange(_SLOWEST / length, min(_FASTEST, 0.4 / coarse.width), _STEP / length)
    if len(cs) < 12 or not len(grid):
        return None
    waves = _waves(cs, grid)
    best: Ripple | None = None
    f = np.zeros(0)
    score = np.inf
    for count in range(1, MOST + 1):
        order = _order(f, length)
        f = np.append(f, _strongest(cs, cn, f, order, waves, grid, coarse.width))
        ripple, rss = refine(fine, f, judge, _order(f, length))
        if ripple is None:
            break
        k = len(fine.s)
        floor = k * judge.sigma**2 / fine.each
        again = k * np.log(max(rss, 0.2 * floor)) + 3 * count * np.log(k)
        if again > score - _WORTH:
            break
        best, f, score = ripple, ripple.f, again
        if ripple.ok and rss < 1.3 * floor:
            break
    return best


@dataclass(frozen=True)
class _Waves:
    """cos and sin (k, m) of every frequency of a grid at the times (k,), and sums of their products (m,)."""

    cos: Array
    sin: Array
    cc: Array
    ss: Array
    cs: Array


def _waves(s: Array, grid: Array) -> _Waves:
    """``grid`` is even: a wave of it is one of the coarse steps times one of the fine ones between them."""
    fine = round(np.sqrt(len(grid)))
    coarse = -(-len(grid) // fine)
    step = grid[1] - grid[0] if len(grid) > 1 else 0.0
    turn = 2j * np.pi * s[:, None]
    steps = np.exp(turn * (grid[0] + step * fine * np.arange(coarse)))
    between = np.exp(turn * (step * np.arange(fine)))
    waves = (steps[:, :, None] * between[:, None, :]).reshape(len(s), -1)[:, : len(grid)]
    cos, sin = np.ascontiguousarray(waves.real), np.ascontiguousarray(waves.imag)
    sums = (np.einsum("km,km->m", a, b) for a, b in ((cos, cos), (sin, sin), (cos, sin)))
    return _Waves(cos, sin, *sums)


def _order(f: Array, length: float) -> int:
    """A parabola only where it cannot be mistaken for a slow sinusoid."""
    return 2 if len(f) and float(np.min(f)) * length > 2.5 else 1


def _strongest(s: Array, n: Array, f: Array, order: int, waves: _Waves, grid: Array, width: float) -> float:
    """The grid's frequency that takes most from what polynomial and present sinusoids leave."""
    V = _basis(s / -s[0], f * -s[0], order, 0.0)
    Q, _ = np.linalg.qr(V)
    r = n - Q @ (Q.T @ n)
    # What polynomial and present sinusoids explain of each wave is taken off its squares, not off the wave.
    C, S = Q.T @ waves.cos, Q.T @ waves.sin
    cc = waves.cc - (C * C).sum(axis=0)
    ss = waves.ss - (S * S).sum(axis=0)
    cs = waves.cs - (C * S).sum(axis=0)
    rc, rs = r @ waves.cos, r @ waves.sin
    det = cc * ss - cs * cs
    gain = np.where(
        det > 1e-4 * cc * ss + 1e-12,
        (ss * rc**2 - 2 * cs * rc * rs + cc * rs**2) / np.maximum(det, 1e-12),
        0.0,
    )
    for present in f:
        gain[np.abs(grid - present) < 0.5 * _STEP / -s[0]] = 0.0
    return float(grid[int(np.argmax(gain))])


def refine(data: Blocks, f: Array, judge: Judge, order: int) -> tuple[Ripple | None, float]:
    """All parameters together from the start frequencies ``f``; and the sum of squared residuals."""
    length = -float(data.s[0])
    now = _linear(data, np.array(f, dtype=float), order)
    N, b, scale = now.normal(data.s, order)
    damping = 1e-3
    for _ in range(_ROUNDS):
        step = np.linalg.solve(N + damping * np.eye(len(N)), b) / scale
        df = np.clip(step[len(now.c) :], -0.3 / length, 0.3 / length)
        trial = _linear(data, np.clip(now.f + df, 0.3 / length, 1.2 * _FASTEST), order)
        if trial.rss < now.rss:
            done = now.rss - trial.rss < 1e-4 * now.rss
            now, damping = trial, damping * 0.2
            N, b, scale = now.normal(data.s, order)
            if done:
                break
        else:
            damping *= 8.0
            if damping > 1e3:
                break
    try:
        inverse = np.linalg.inv(N + 1e-12 * np.eye(len(N)))
    except np.linalg.LinAlgError:
        return None, now.rss
    variance = max(judge.sigma**2 / data.each, now.rss / max(len(now.r) - len(N), 1))
    cov = variance * inverse / scale / scale[:, None]
    # Ripple that has been followed for long is not given up for a chance that one block in thousands takes.
    ok = replace(judge, patience=_PATIENCE).passes(now.r, float(now.c[1]), data.each)
    return Ripple(now.c, now.f, order, cov, length, ok), now.rss


@dataclass(frozen=True)
class _Linear:
    """Best coefficients ``c`` at given frequencies ``f``, the residual ``r`` and its sum of squares."""

    f: Array
    basis: Array
    c: Array
    r: Array
    rss: float

    def normal(self, s: Array, order: int) -> tuple[Array, Array, Array]:
        """Normal matrix and right side of the Jacobian by (c, f), its columns made 1 long; and how long they
        were."""
        J = _with_frequencies(self.basis, s, order, self.c)
        N = J.T @ J
        scale = np.sqrt(np.diag(N)) + 1e-300
        return N / scale / scale[:, None], (J.T @ self.r) / scale, scale


def _linear(data: Blocks, f: Array, order: int) -> _Linear:
    basis = _basis(data.s, f, order, data.width)
    N = basis.T @ basis
    scale = np.sqrt(np.diag(N)) + 1e-300
    N = N / scale / scale[:, None] + 1e-11 * np.eye(len(N))
    c = np.linalg.solve(N, (basis.T @ data.n) / scale) / scale
    r = data.n - basis @ c
    return _Linear(f, basis, c, r, float(r @ r))
