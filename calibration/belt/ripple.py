"""A belt that runs with ripple: a line (or a parabola) and up to three sinusoids, fitted to the counts.

Ripple comes from drums that are out of round and from gears; it keeps its frequency for long. The frequencies
are searched on a grid, one sinusoid after the other, then all parameters are refined together.
"""

from dataclasses import dataclass, replace

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

    def speed(self, s: Array) -> Array:
        """Counts per second at ``now + s``."""
        p = np.arange(1, self.order + 1)
        out = (p * s[:, None] ** (p - 1)) @ self.c[1 : self.order + 1]
        w = 2.0 * np.pi * self.f
        a, b = self.c[self.order + 1 :: 2], self.c[self.order + 2 :: 2]
        x = s[:, None] * w
        return np.asarray(out + (np.cos(x) * (b * w) - np.sin(x) * (a * w)).sum(axis=1))

    def gradient(self, s: Array) -> Array:
        """Derivative of the position by (c, f), shape (k, parameters)."""
        return _jacobian(s, self.f, self.order, 0.0, self.c)


def _basis(s: Array, f: Array, order: int, width: float) -> Array:
    x = 2.0 * np.pi * s[:, None] * f
    damp = np.sinc(f * width)  # a mean over ``width`` sees that much of a sinusoid
    waves = np.stack([np.cos(x) * damp, np.sin(x) * damp], axis=2).reshape(len(s), -1)
    return np.concatenate([s[:, None] ** np.arange(order + 1), waves], axis=1)


def _jacobian(s: Array, f: Array, order: int, width: float, c: Array) -> Array:
    basis = _basis(s, f, order, width)
    waves = basis[:, order + 1 :]
    a, b = c[order + 1 :: 2], c[order + 2 :: 2]
    by_f = 2.0 * np.pi * s[:, None] * (waves[:, ::2] * b - waves[:, 1::2] * a)
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
    grid = np.arange(_SLOWEST / length, min(_FASTEST, 0.4 / coarse.width), _STEP / length)
    if len(cs) < 12 or not len(grid):
        return None
    waves = np.exp(2j * np.pi * cs[:, None] * grid)
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


def _order(f: Array, length: float) -> int:
    """A parabola only where it cannot be mistaken for a slow sinusoid."""
    return 2 if len(f) and float(np.min(f)) * length > 2.5 else 1


def _strongest(s: Array, n: Array, f: Array, order: int, waves: Array, grid: Array, width: float) -> float:
    """The grid's frequency that takes most from what polynomial and present sinusoids leave."""
    V = _basis(s / -s[0], f * -s[0], order, 0.0)
    Q, _ = np.linalg.qr(V)
    r = n - Q @ (Q.T @ n)
    C, S = np.real(waves), np.imag(waves)
    C, S = C - Q @ (Q.T @ C), S - Q @ (Q.T @ S)
    cc, ss, cs = (C * C).sum(axis=0), (S * S).sum(axis=0), (C * S).sum(axis=0)
    rc, rs = r @ C, r @ S
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
    f = np.array(f, dtype=float)
    c, rss = _linear(data, f, order)
    damping = 1e-3
    for _ in range(_ROUNDS):
        J = _jacobian(data.s, f, order, data.width, c)
        r = data.n - J[:, : len(c)] @ c
        scale = np.linalg.norm(J, axis=0) + 1e-300
        A = J / scale
        N = A.T @ A
        step = np.linalg.solve(N + damping * np.eye(len(N)), A.T @ r) / scale
        df = np.clip(step[len(c) :], -0.3 / length, 0.3 / length)
        trial = np.clip(f + df, 0.3 / length, 1.2 * _FASTEST)
        c_new, rss_new = _linear(data, trial, order)
        if rss_new < rss:
            done = rss - rss_new < 1e-4 * rss
            f, c, rss, damping = trial, c_new, rss_new, damping * 0.2
            if done:
                break
        else:
            damping *= 8.0
            if damping > 1e3:
                break
    J = _jacobian(data.s, f, order, data.width, c)
    r = data.n - J[:, : len(c)] @ c
    scale = np.linalg.norm(J, axis=0) + 1e-300
    A = J / scale
    try:
        inverse = np.linalg.inv(A.T @ A + 1e-12 * np.eye(A.shape[1]))
    except np.linalg.LinAlgError:
        return None, rss
    variance = max(judge.sigma**2 / data.each, rss / max(len(r) - A.shape[1], 1))
    cov = variance * inverse / scale / scale[:, None]
    # Ripple that has been followed for long is not given up for a chance that one block in thousands takes.
    ok = replace(judge, patience=_PATIENCE).passes(r, float(c[1]), data.each)
    return Ripple(c, f, order, cov, length, ok), rss


def _linear(data: Blocks, f: Array, order: int) -> tuple[Array, float]:
    basis = _basis(data.s, f, order, data.width)
    scale = np.linalg.norm(basis, axis=0) + 1e-300
    A = basis / scale
    c = np.linalg.solve(A.T @ A + 1e-11 * np.eye(A.shape[1]), A.T @ data.n) / scale
    r = data.n - basis @ c
    return c, float(r @ r)
