"""Views as arrays, so that all of them are worked on at once."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.hand_eye.views import CornerSet, distortion_jacobian, undistort
from cell.devices import Intrinsics
from cell.poses import Array

Indices = NDArray[np.int64]


@dataclass(frozen=True)
class ViewStack:
    """n views padded to one length: points (n, 3, m), ideal coordinates (n, 2, m), ``inside`` (n, m).

    ``whiten`` (2, n, 2, m) holds the columns of the matrix that carries an error of ideal coordinates to
    pixels, times the root of the averaged frames. Padding is the target's origin with no weight. ``sizes``
    (n,) are the views' own numbers of corners.
    """

    points: Array
    ideal: Array
    whiten: Array
    inside: NDArray[np.bool_]
    sizes: Indices

    def __len__(self) -> int:
        return len(self.sizes)

    def take(self, rows: Indices) -> "ViewStack":
        """Those of some rows, in that order."""
        if len(rows) == len(self) and np.array_equal(rows, np.arange(len(self))):
            return self
        return ViewStack(
            self.points[rows], self.ideal[rows], self.whiten[:, rows], self.inside[rows], self.sizes[rows]
        )


def view_stack(views: Sequence[CornerSet], camera: Intrinsics) -> ViewStack:
    """At least one view."""
    sizes = np.array([len(v.points) for v in views])
    inside = np.arange(sizes.max()) < sizes[:, None]
    ideal = undistort(np.concatenate([v.corners for v in views]), camera)
    weight = np.sqrt(np.concatenate([v.count for v in views]))
    whiten = distortion_jacobian(ideal, camera) * weight[:, None, None]

    def padded(values: Array) -> Array:
        """(n, k, m) of (all, k)."""
        if not inside.all():
            given, values = values, np.zeros((inside.size, values.shape[1]))
            values[inside.ravel()] = given
        return np.ascontiguousarray(np.swapaxes(values.reshape(*inside.shape, -1), 1, 2))

    return ViewStack(
        padded(np.concatenate([v.points for v in views])),
        padded(ideal),
        np.stack([padded(whiten[:, :, k]) for k in (0, 1)]),
        inside,
        sizes,
    )
