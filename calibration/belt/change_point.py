"""A belt that has just begun, or just ended, to speed up or slow down.

Belts start and stop with a nearly constant acceleration. In the first moments a window that holds only
the new motion says little, but the motion before is well known and speed does not jump: a line that turns
into a parabola at an unknown instant, or a parabola into a line. All instants are weighed by how well they
explain the counts.
"""

import numpy as np

from calibration.belt.fit import Judge, Window, line_and_bend
from cell.poses import Array

_BEFORE = (6, 10, 16, 24)  # newest frames left out to see the motion before
_KNOWN = 0.12  # s of motion before
_LOOK = 0.5  # s of it that are used
_EARLIER = 8  # frames before those left out in which the change may lie
_LATEST = 2  # frames after the change, at least
_UNCHANGED = 10.0  # times as likely as a change at any one instant
_POSSIBLE = 0.02
_HARDEST = 6.0  # m/s^2
_ACCELERATION = 2.0  # m/s^2, usual size; matters only while the counts say nothing


def kinked(
    s: Array, n: Array, judge: Judge, m_per_count: float, speeds: tuple[float, float]
) -> Window | None:
    """The motion now, as a parabola since the change; None when the motion before is not known.

    ``s`` (k,) <= 0 in seconds, ``n`` (k,) counts, ``speeds`` (counts/s) the lowest and the highest that are
    believed of a motion that does not explain the counts, or of the one before that is carried on. The
    coefficients are a mean over all instants of the change, the covariance holds their disagreement.
    """
    for late in _BEFORE:
        if len(s) < late + 24:
            return None
        old = slice(0, len(s) - late)
        line, bend = line_and_bend(s[old], n[old], judge)
        before = bend if bend.length > 1.6 * line.length else line
        begins = before.length + s[old.stop - 1]
        if before.ok and -s[old.stop - 1] + begins > _KNOWN:
            found = _mean(s, n, -min(before.length, _LOOK - s[old.stop - 1]), late, judge, m_per_count)
            if found is None:
                return None
            gentle = 2.0 * abs(float(found.c[2]) * m_per_count) < _HARDEST
            if found.ok or (gentle and speeds[0] <= found.c[1] <= speeds[1]):
                return found
            # What no belt can do is misplaced frames; the motion before them is the better guess.
            return before if speeds[0] <= before.c[1] <= speeds[1] else None
    return None


def _mean(s: Array, n: Array, begin: float, late: int, judge: Judge, m_per_count: float) -> Window | None:
    rows = s >= begin
    s, n = s[rows], n[rows]
    latest, earliest = len(s) - 1 - _LATEST, max(len(s) - late - _EARLIER, 2)
    knots = s[earliest : latest + 1]
    if not len(knots):
        return None
    after = np.maximum(s - knots[:, None], 0.0) ** 2
    ones, line, square = (np.broadcast_to(x, after.shape) for x in (np.ones(len(s)), s, s * s))
    size = 0.5 * _ACCELERATION / abs(m_per_count)
    found = [
        _fit(np.stack([ones[: len(bent)], line[: len(bent)], bent], axis=2), n, size, judge.sigma)
        for bent in (after, square - after, square[:1])
    ]
    # After the change: c0 + c1 s + d (s - s0)^2, and c0 + c1 s + d (2 s0 s - s0^2).
    one, zero = np.ones(len(knots)), np.zeros(len(knots))
    turned = (
        np.stack(
            [np.stack([one, zero, knots**2]), np.stack([zero, one, -2 * knots]), np.stack([zero, zero, one])]
        ),
        np.stack(
            [np.stack([one, zero, -(knots**2)]), np.stack([zero, one, 2 * knots]), np.zeros((3, len(knots)))]
        ),
        np.eye(3)[:, :, None],
    )
    c = np.concatenate([np.einsum("ijk,kj->ki", T, f[0]) for T, f in zip(turned, found, strict=True)])
    cov = np.concatenate(
        [np.einsum("ijk,kjl,mlk->kim", T, f[1], T) for T, f in zip(turned, found, strict=True)]
    )
    misfit = np.concatenate([f[2] for f in found])
    misfit[-1] -= 2.0 * np.log(_UNCHANGED * len(knots))
    w = np.exp(-0.5 * (misfit - misfit.min()))
    w /= w.sum()
    mean = w @ c
    off = c - mean
    spread = np.einsum("k,kij->ij", w, cov) + np.einsum("k,ki,kj->ij", w, off, off)
    k = int(np.argmax(w))
    since_s = np.concatenate([knots, knots, s[:1]])
    s0 = float(since_s[w > _POSSIBLE].max())  # the mean is no motion of before any of the changes
    since = int(np.sum(s >= s0))
    ok = judge.passes((n - np.stack([s**0, s, s * s], axis=1) @ c[k])[-since:], float(c[k, 1]))
    return Window(mean, spread, since, -s0, ok)


def _fit(V: Array, n: Array, size: float, sigma: float) -> tuple[Array, Array, Array]:
    """Coefficients (k, 3), covariances (k, 3, 3) and misfits (k,) of k designs ``V`` (k, rows, 3)."""
    origin = n[-1]
    y = n - origin
    scale = np.maximum(np.sqrt(np.einsum("krj,krj->kj", V, V)), 1e-12)
    A = V / scale[:, None, :]
    N = np.swapaxes(A, 1, 2) @ A
    prior = (sigma / size / scale[:, 2]) ** 2
    N[:, 2, 2] += prior
    inverse = np.linalg.inv(N + 1e-12 * np.eye(3))
    b = np.einsum("krj,r->kj", A, y)
    c = np.einsum("kij,kj->ki", inverse, b)
    r = y - np.einsum("krj,kj->kr", A, c)
    misfit = (np.einsum("kr,kr->k", r, r) + prior * c[:, 2] ** 2) / sigma**2
    c = c / scale
    c[:, 0] += origin
    return c, sigma**2 * inverse / scale[:, :, None] / scale[:, None, :], misfit
