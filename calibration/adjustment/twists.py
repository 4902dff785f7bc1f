"""Twists of the flange by an arm's numbers, held as they are or made when some poses of them are asked for.

Of thousands of poses the derivatives by a hundred numbers take as much memory as all else together, and each
is wanted for a moment only.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from cell.poses import Array


class Twists(Protocol):
    """For n poses and a numbers: motions of the flange in its own frame, (n, 6, a)."""

    @property
    def numbers(self) -> int:
        """a."""

    def moved(self, x: Array) -> Array:
        """(n, 6): the motions by the numbers ``x`` (a,)."""

    def carried(self, by: Array, rows: slice, out: Array) -> None:
        """``by`` (k, d, 6) times the twists of the poses ``rows``, into ``out`` (k, d, a)."""


@dataclass(frozen=True)
class StoredTwists:
    """``columns`` (n, 6, a)."""

    columns: Array

    @property
    def numbers(self) -> int:
        return int(self.columns.shape[2])

    def moved(self, x: Array) -> Array:
        out: Array = self.columns @ x
        return out

    def carried(self, by: Array, rows: slice, out: Array) -> None:
        np.matmul(by, self.columns[rows], out=out)


@dataclass(frozen=True)
class FunctionTwists:
    """Place and attitude by c functions of the pose along each axis of the base, and along the flange's.

    ``values`` (n, c) are the functions at poses with the attitudes ``R`` (n, 3, 3). The numbers are those of
    the place, function by function along x, y and z and then one an axis of the flange, and in the same order
    those of the attitude.
    """

    values: Array
    R: Array

    @property
    def numbers(self) -> int:
        return int(6 * (self.values.shape[1] + 1))

    def moved(self, x: Array) -> Array:
        count = self.values.shape[1]
        halves = []
        for own in np.split(x, 2):
            in_base = self.values @ own[: 3 * count].reshape(3, count).T
            halves.append((in_base[:, None] @ self.R)[:, 0] + own[3 * count :])
        return np.concatenate(halves, axis=1)

    def columns(self, rows: slice) -> Array:
        """(k, 6, a)."""
        by = np.broadcast_to(np.eye(6), (len(self.values[rows]), 6, 6))
        out = np.empty((len(by), 6, self.numbers))
        self.carried(by, rows, out)
        return out

    def carried(self, by: Array, rows: slice, out: Array) -> None:
        values, R = self.values[rows], self.R[rows]
        (k, d, _), count = by.shape, values.shape[1]
        of_base = 3 * count
        for half, first in ((by[..., :3], 0), (by[..., 3:], of_base + 3)):
            along = half @ np.swapaxes(R, 1, 2)
            part = along[..., None] * values[:, None, None]
            out[..., first : first + of_base] = part.reshape(k, d, of_base)
            out[..., first + of_base : first + of_base + 3] = half
