"""Points spread evenly over a unit cube, the same in each call: Sobol's sequence, scrambled.

SciPy has it too, but its module of statistics takes half a second of each process that imports it.
"""

import numpy as np
from numpy.typing import NDArray

from cell.poses import Array

_BITS = 30
_WEIGHTS = 2 ** np.arange(_BITS - 1, -1, -1, dtype=np.int64)  # the first bit is the largest
# For each dimension after the first: a primitive polynomial, by its bits, and the first direction numbers.
# Source: Joe and Kuo, "Constructing Sobol sequences with better two-dimensional projections" (2008).
_DIRECTIONS = (
    (3, (1,)),
    (7, (1, 3)),
    (11, (1, 3, 1)),
    (13, (1, 1, 1)),
    (19, (1, 1, 3, 3)),
    (25, (1, 3, 5, 13)),
    (37, (1, 1, 5, 5, 17)),
    (41, (1, 1, 5, 5, 5)),
    (47, (1, 1, 7, 11, 19)),
    (55, (1, 1, 5, 1, 1)),
    (59, (1, 1, 1, 3, 11)),
    (61, (1, 3, 5, 5, 31)),
    (67, (1, 3, 3, 9, 7, 49)),
    (91, (1, 1, 1, 15, 21, 21)),
    (97, (1, 3, 1, 13, 27, 49)),
    (103, (1, 1, 1, 15, 7, 5)),
    (109, (1, 3, 1, 15, 13, 25)),
    (115, (1, 1, 5, 5, 19, 61)),
    (131, (1, 3, 7, 11, 23, 15, 103)),
    (137, (1, 3, 7, 13, 13, 15, 69)),
    (143, (1, 1, 3, 13, 7, 35, 63)),
    (145, (1, 3, 5, 9, 1, 25, 53)),
    (157, (1, 3, 1, 13, 9, 35, 107)),
    (167, (1, 3, 1, 5, 27, 61, 31)),
    (171, (1, 1, 5, 11, 19, 41, 61)),
    (185, (1, 3, 5, 3, 3, 13, 69)),
    (191, (1, 1, 7, 13, 1, 19, 1)),
    (193, (1, 3, 7, 5, 13, 19, 59)),
    (203, (1, 1, 3, 9, 25, 29, 41)),
)
MOST_DIMENSIONS = 1 + len(_DIRECTIONS)


def even_points(dimensions: int, power: int, seed: int) -> Array:
    """(2 ** power, dimensions) points in 0 .. 1, for at most ``MOST_DIMENSIONS`` dimensions.

    Scrambled by a random lower triangular matrix and a shift of the digits (Matousek, "On the
    L2-discrepancy for anchored boxes", 1998), both drawn with ``seed``.
    """
    rng = np.random.default_rng(seed)
    shift = rng.integers(2, size=(dimensions, _BITS), dtype=np.uint32).astype(np.int64) @ _WEIGHTS[::-1]
    turned = np.tril(rng.integers(2, size=(dimensions, _BITS, _BITS), dtype=np.uint32)).astype(np.int64)
    turned[:, np.arange(_BITS), np.arange(_BITS)] = 1
    digits = np.stack([_digits(d) for d in range(dimensions)])  # (dimensions, digit, number)
    numbers = _WEIGHTS @ (turned @ digits % 2)
    points = shift[None]
    for number in numbers.T[:power]:  # in the order of Gray's code
        points = np.concatenate([points, points[::-1] ^ number])
    return np.asarray(points / 2.0**_BITS)


def _digits(dimension: int) -> NDArray[np.int64]:
    """(digit, number) of the direction numbers of one dimension."""
    numbers = [1] * _BITS
    if dimension:
        polynomial, first = _DIRECTIONS[dimension - 1]
        degree = len(first)
        numbers[:degree] = first
        for j in range(degree, _BITS):
            new = numbers[j - degree]
            for k in range(1, degree + 1):
                if polynomial >> (degree - k) & 1:
                    new ^= numbers[j - k] << k
            numbers[j] = new
    scaled = np.array([number * int(weight) for number, weight in zip(numbers, _WEIGHTS, strict=True)])
    return scaled // _WEIGHTS[:, None] % 2
