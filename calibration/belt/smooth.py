"""The belt's travel at a past instant, from the counts on both sides of it."""

import numpy as np

from cell.poses import Array

NEAR = 4  # frames on either side
_QUANTUM = 12.0**-0.5  # counts


def smooth(t: Array, n: Array, at: Array) -> tuple[Array, Array]:
    """Parabolas through the frames around each of ``at`` (k,), and standard deviations, counts.

    Where there are no frames on both sides the nearest counts stand alone.
    """
    value, sigma = np.interp(at, t, n), np.full(len(at), 0.5)
    wide = 2 * NEAR
    if len(t) < wide:
        return value, sigma
    first = np.clip(np.searchsorted(t, at) - NEAR, 0, len(t) - wide)
    rows = first[:, None] + np.arange(wide)
    x, y = t[rows], n[rows]
    inside = (at >= x[:, 0]) & (at <= x[:, -1]) & (np.diff(x, axis=1).min(axis=1) > 0.0)
    if not inside.any():
        return value, sigma
    length = (x[inside, -1] - x[inside, 0])[:, None]
    u = (x[inside] - at[inside, None]) / length
    V = np.stack([np.ones_like(u), u, u * u], axis=2)
    inverse = np.linalg.inv(np.swapaxes(V, 1, 2) @ V)
    y0 = y[inside, :1]
    right = np.einsum("kij,ki->kj", V, y[inside] - y0)
    value[inside] = y0[:, 0] + np.einsum("kj,kj->k", inverse[:, 0], right)
    sigma[inside] = _QUANTUM * np.sqrt(inverse[:, 0, 0])
    return value, sigma
