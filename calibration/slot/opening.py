"""Where a known opening is before the camera: the most likely pose by its edges and by what was known before.

Depth and tilt hardly show in a small rectangle, so what the rack's model says of them stays in force through
the prior; the place across the sight is what the edges tell. The covariance says both.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from calibration.slot.edges import PROFILE_PX, SideEdges, coarse_shift, side_edges
from calibration.slot.rectangle import Rectangle, motion_px, outward_px, project
from cell.devices import Intrinsics
from cell.errors import error
from cell.poses import Array, exp_xi, log_xi

SYSTEMATIC_PX = 0.1  # of a whole side, and by which its ends turn: shading, an edge that is not sharp
_LEAST_PX = 0.03  # noise of one edge point
_ROUNDS = 6
_SETTLED = 1e-7
_LEAST_EDGE = 2.0  # grey levels/px of the weakest side in a coarse look
_MARGIN_PX = 8.0
_NEAR_PX = 24.0  # around a rim that is found to some pixels


@dataclass(frozen=True)
class Expected:
    """``T_camera`` of the opening, and its covariance (6, 6), perturbation on the right."""

    T_camera: RigidTransform
    cov: Array


@dataclass(frozen=True)
class FoundOpening:
    """``T_camera`` of the opening with its covariance (6, 6), perturbation on the right; how it was found.

    ``edge_px``: RMS distance of the edge points from the rim; ``contrast``: of each side, grey levels;
    ``moved_px``: how far from where it was expected. ``by_marker`` (6, 6): what the place of a marker beside
    the opening leaves open, beyond ``cov``.
    """

    T_camera: RigidTransform
    cov: Array
    edge_px: float
    contrast: tuple[float, ...]
    moved_px: float
    by_marker: Array | None = None


def find_opening(
    colour: NDArray[np.uint8], camera: Intrinsics, opening: Rectangle, expected: Expected, reach_m: float
) -> FoundOpening:
    """The pose by the edges in ``colour`` (h, w, 3), at most ``reach_m`` beside ``expected``.

    ``OPENING_NOT_SEEN`` says which sides show no edge.
    """
    return by_edges(colour, camera, opening, expected, _shifted(colour, camera, opening, expected, reach_m))


def by_edges(
    colour: NDArray[np.uint8],
    camera: Intrinsics,
    opening: Rectangle,
    expected: Expected,
    start: RigidTransform,
    profile_px: float = PROFILE_PX,
) -> FoundOpening:
    """The same from ``start``, a few pixels from it at most, by profiles of this length to either side."""
    T = start
    rim, outward = outward_px(camera, T, opening)
    near, corner = _cut(colour, rim, _NEAR_PX)
    for _ in range(_ROUNDS):
        rim, outward = outward_px(camera, T, opening)
        edges = _all_four(side_edges(near, rim - corner, outward, profile_px))
        step, cov = _step(camera, opening, T, expected, edges, outward)
        T = T * exp_xi(step)
        if np.max(np.abs(step)) < _SETTLED:
            break
    there, here = (project(camera, pose, np.zeros((1, 3)))[0] for pose in (T, expected.T_camera))
    return FoundOpening(
        T,
        cov,
        float(np.sqrt(np.mean(edges.off_px[edges.used] ** 2))),
        tuple(float(c) for c in edges.contrast),
        float(np.linalg.norm(there - here)),
    )


def _shifted(
    colour: NDArray[np.uint8], camera: Intrinsics, opening: Rectangle, expected: Expected, reach_m: float
) -> RigidTransform:
    """``expected`` shifted across the sight to where the four sides are edges."""
    T = expected.T_camera
    rim, outward = outward_px(camera, T, opening)
    size = np.array([camera.width, camera.height])
    if np.any(rim < _MARGIN_PX) or np.any(rim > size - 1.0 - _MARGIN_PX):
        raise error("OPENING_NOT_SEEN", "it would not lie wholly in the picture")
    per_m = motion_px(camera, T, np.zeros((1, 3)))[0][:, :2]  # px by m along x and y of the opening
    room = np.minimum(rim.min(axis=(0, 1)), size - 1.0 - rim.max(axis=(0, 1))) - _MARGIN_PX
    reach = np.minimum(reach_m * np.linalg.norm(per_m, axis=0).mean(), room)
    near, corner = _cut(colour, rim, float(reach.max()) + _MARGIN_PX)
    shift, weakest = coarse_shift(near, rim - corner, outward, reach)
    if weakest < _LEAST_EDGE:
        raise error(
            "OPENING_NOT_SEEN", f"nothing like it within {1e3 * reach_m:.1f} mm of where it should be"
        )
    along = np.linalg.solve(per_m, shift)
    return T * RigidTransform.from_translation([along[0], along[1], 0.0])


def _cut(colour: NDArray[np.uint8], rim: Array, around_px: float) -> tuple[NDArray[np.float32], Array]:
    """The part of ``colour`` around ``rim`` (4, n, 2), and its upper left pixel (2,)."""
    low = np.maximum(np.floor(rim.min(axis=(0, 1)) - around_px), 0.0).astype(int)
    high = np.ceil(rim.max(axis=(0, 1)) + around_px).astype(int) + 1
    return colour[low[1] : high[1], low[0] : high[0]].astype(np.float32), low.astype(float)


def _all_four(edges: SideEdges) -> SideEdges:
    if not edges.seen.all():
        names = zip(("left", "right", "upper", "lower"), edges.seen, strict=True)
        dim = [name for name, seen in names if not seen]
        raise error("OPENING_NOT_SEEN", f"no edge on its {' and '.join(dim)} side")
    return edges


def _step(
    camera: Intrinsics,
    opening: Rectangle,
    T: RigidTransform,
    expected: Expected,
    edges: SideEdges,
    outward: Array,
) -> tuple[Array, Array]:
    """The step (6,) to the most likely pose, and the covariance (6, 6) there."""
    points = opening.rim()
    J = motion_px(camera, T, points.reshape(-1, 3)).reshape(4, -1, 2, 6)
    prior = np.linalg.inv(expected.cov)
    N, b = prior.copy(), -prior @ log_xi(expected.T_camera.inv() * T)
    for side in range(4):
        use = edges.used[side]
        rows = np.einsum("nk,nkp->np", outward[side][use], J[side][use])
        off = edges.off_px[side][use]
        W = _weight(off)
        N += rows.T @ W @ rows
        b += rows.T @ W @ off
    return np.linalg.solve(N, b), np.linalg.inv(N)


def _weight(off: Array) -> Array:
    """(n, n) inverse covariance of the edge points of a side: noise of each, a shift and a turn of all."""
    n = len(off)
    x = np.linspace(-1.0, 1.0, n)
    left = off - np.polynomial.Polynomial.fit(x, off, 1)(x)
    var = max(float(left @ left) / max(n - 2, 1), _LEAST_PX**2)
    shared = SYSTEMATIC_PX**2 * (1.0 + np.outer(x, x))
    return np.asarray(np.linalg.inv(var * np.eye(n) + shared))
