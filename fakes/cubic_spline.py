"""Cubic splines through values at even distances, as SciPy's with its usual ends ("not-a-knot").

``scipy.interpolate`` takes a fifth of a second of each process that imports it; the twin's arm and camera
need no more than this of it.
"""

from functools import lru_cache

import numpy as np

from cell.poses import Array


def coefficients(step: float, values: Array) -> Array:
    """(4, n - 1, ...) cubic pieces through ``values`` (n, ...), n > 3, each ``step`` after the one before.

    The highest power comes first, in the distance from the piece's begin.
    """
    slopes = np.tensordot(_slopes(len(values)), values, 1) / step
    mean = np.diff(values, axis=0) / step
    begin, end = slopes[:-1], slopes[1:]
    return np.stack(
        [(begin + end - 2.0 * mean) / step**2, (3.0 * mean - 2.0 * begin - end) / step, begin, values[:-1]]
    )


def weights(count: int, at: Array) -> Array:
    """(m, count): ``weights @ values`` is the spline through ``values`` at 0, 1, 2, ... at ``at`` (m,)."""
    piece = np.clip(np.floor(at).astype(int), 0, count - 2)
    x = (at - piece)[:, None]
    a, b, c, d = (k[piece] for k in coefficients(1.0, np.eye(count)))
    found: Array = ((a * x + b) * x + c) * x + d
    return found


@lru_cache
def _slopes(n: int) -> Array:
    """(n, n): the slopes at the values are this times them, where the step is 1."""
    if n < 4:
        raise ValueError(f"a spline needs at least 4 values, not {n}")
    of_slopes = 4.0 * np.eye(n) + np.eye(n, k=1) + np.eye(n, k=-1)
    of_values = 3.0 * (np.eye(n, k=1) - np.eye(n, k=-1))
    # The first two pieces are one cubic, and so are the last two.
    of_slopes[0], of_values[0] = 0.0, 0.0
    of_slopes[0, :2], of_values[0, :3] = (1.0, 2.0), (-2.5, 2.0, 0.5)
    of_slopes[-1], of_values[-1] = of_slopes[0, ::-1], -of_values[0, ::-1]
    found = np.asarray(np.linalg.solve(of_slopes, of_values), np.float64)
    found.flags.writeable = False
    return found
