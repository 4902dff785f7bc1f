"""Pose of a target from its corners, for all images at once, with covariance.

Corners are turned into ideal (undistorted) coordinates once; a residual is carried back to pixels by the
local Jacobian of the distortion, which is exact to first order. What is left is a pinhole adjustment of six
numbers per image, done by Gauss-Newton on all images together.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from calibration.hand_eye import se3
from calibration.hand_eye.pnp_start import mirrored, start_poses
from calibration.hand_eye.views import CornerSet, distortion_jacobian, ideal_corners
from cell.devices import Intrinsics
from cell.poses import Array

Indices = NDArray[np.int64]
_AMBIGUOUS = 3.0  # a second pose is kept while its squared error is below this times that of the first
_HOPELESS_START = 1000.0  # and not worth refining when far above it from the start
_HOPELESS = 100.0  # or still after two steps
_ITERATIONS, _SHORT = 15, 0.01


@dataclass(frozen=True)
class Poses:
    """Poses of n observations. ``cov`` is for corners with a noise of 1 px in each frame.

    ``C`` (n, 4, 4) is T_camera_target, ``cov`` (n, 6, 6) belongs to a perturbation on its left, that is in
    the camera frame; ``sse`` (n,) is the weighted sum of squared residuals in px^2, ``corners`` (n,) their
    number.
    """

    C: Array
    cov: Array
    sse: Array
    corners: Indices

    def take(self, rows: Indices) -> "Poses":
        """Those of some rows, in that order."""
        return Poses(self.C[rows], self.cov[rows], self.sse[rows], self.corners[rows])

    def joined(self, other: "Poses") -> "Poses":
        """These, then those of ``other``."""
        pairs = ((getattr(self, f.name), getattr(other, f.name)) for f in fields(self))
        return Poses(*(np.concatenate(pair) for pair in pairs))


@dataclass(frozen=True)
class _Stack:
    """Views padded to one length: points (n, 3, m), ideal coordinates (n, 2, m), whitening 2 x 2 of (n, m).

    Padding is the target's origin with no weight.
    """

    points: Array
    ideal: Array
    whiten: tuple[tuple[Array, Array], tuple[Array, Array]]

    def take(self, rows: Indices) -> "_Stack":
        (a, b), (c, d) = self.whiten
        whiten = ((a[rows], b[rows]), (c[rows], d[rows]))
        return _Stack(self.points[rows], self.ideal[rows], whiten)


def _stack(views: Sequence[CornerSet], ideal: Sequence[Array], camera: Intrinsics) -> _Stack:
    n = len(views)
    sizes = np.array([len(v.points) for v in views])
    m = int(sizes.max())
    inside = np.arange(m) < sizes[:, None]
    weight = np.sqrt(np.concatenate([v.count for v in views]))
    flat = np.concatenate(ideal)
    distortion = distortion_jacobian(flat, camera)

    def padded(values: Array) -> Array:
        if inside.all():
            return values.reshape(n, m)
        out = np.zeros((n, m))
        out[inside] = values
        return out

    points = np.concatenate([v.points for v in views])
    return _Stack(
        np.stack([padded(points[:, k]) for k in range(3)], axis=1),
        np.stack([padded(flat[:, k]) for k in range(2)], axis=1),
        (
            (padded(weight * distortion[:, 0, 0]), padded(weight * distortion[:, 0, 1])),
            (padded(weight * distortion[:, 1, 0]), padded(weight * distortion[:, 1, 1])),
        ),
    )


def _residuals(stack: _Stack, C: Array) -> tuple[Array, Array, Array]:
    """Whitened residuals (n, 2, m), measured minus predicted, ideal coordinates and depths."""
    p = C[:, :3, :3] @ stack.points + C[:, :3, 3:]
    iz = 1.0 / p[:, 2]
    flat = p[:, :2] * iz[:, None]
    off = stack.ideal - flat
    r = np.empty_like(off)
    for k in (0, 1):
        r[:, k] = stack.whiten[k][0] * off[:, 0] + stack.whiten[k][1] * off[:, 1]
    return r, flat, iz


def _jacobian(stack: _Stack, flat: Array, iz: Array) -> Array:
    """d predicted / d xi for a perturbation on the left of C, whitened, (n, 6, 2 m)."""
    n, _, m = flat.shape
    x, y = flat[:, 0], flat[:, 1]
    xy, zero = x * y, np.zeros_like(x)
    du = (iz, zero, -x * iz, -xy, 1.0 + x * x, -y)
    dv = (zero, iz, -y * iz, -1.0 - y * y, xy, x)
    d = np.empty((n, 6, 2, m))
    for k in (0, 1):
        for j in range(6):
            np.multiply(stack.whiten[k][0], du[j], out=d[:, j, k])
            d[:, j, k] += stack.whiten[k][1] * dv[j]
    return d.reshape(n, 6, 2 * m)


def _refine(everything: _Stack, sizes: Indices, C: Array, give_up: Array | None = None) -> Poses:
    """Gauss-Newton from ``C`` (n, 4, 4), each view until its step is shorter than 1 % of its uncertainty.

    The step that is that short is taken too, so what remains is far smaller. A view whose squared error is
    still above ``give_up`` (n,) after two steps is left where it is.
    """
    n = len(C)
    C, cov, sse = C.copy(), np.zeros((n, 6, 6)), np.zeros(n)
    rows = np.arange(n)
    for iteration in range(_ITERATIONS):
        stack = everything if len(rows) == n else everything.take(rows)
        r, flat, iz = _residuals(stack, C[rows])
        Jt = _jacobian(stack, flat, iz)
        N = Jt @ np.swapaxes(Jt, 1, 2)
        N += 1e-12 * np.trace(N, axis1=1, axis2=2)[:, None, None] * np.eye(6)
        g = (Jt @ r.reshape(len(rows), -1, 1))[..., 0]
        cov[rows] = np.linalg.inv(N)
        step = (cov[rows] @ g[..., None])[..., 0]
        gain = np.sum(step * g, axis=1)
        before = np.asarray(np.einsum("nkm,nkm->n", r, r))
        C[rows] = se3.exp(step) @ C[rows]
        sse[rows] = np.maximum(before - gain, 0.0)
        variance = np.maximum(sse[rows] / np.maximum(2 * sizes[rows] - 6, 1), 1e-4)
        active = gain > _SHORT**2 * variance
        if give_up is not None and iteration >= 1:
            hopeless = before >= give_up[rows]
            sse[rows[hopeless]] = before[hopeless]
            active &= ~hopeless
        rows = rows[active]
        if not len(rows):
            break
    return Poses(C, cov, sse, sizes)


def refine_poses(views: Sequence[CornerSet], camera: Intrinsics, C: Array) -> Poses:
    """The pose of each view from ``C`` (n, 4, 4), which is near it: no second pose is looked for."""
    stack = _stack(views, ideal_corners(views, camera), camera)
    return _refine(stack, np.array([len(v.points) for v in views]), C)


def solve_pnp(views: Sequence[CornerSet], camera: Intrinsics) -> tuple[Poses, Indices]:
    """Every pose that explains a view, and the view (k,) that each belongs to, best one of each first.

    A planar target seen with little perspective has a second pose, mirrored in its line of sight, that fits
    nearly as well: it is kept, and the robot's motion decides. Every view needs four corners or more that do
    not lie on a line, and a start that is not NaN.
    """
    ideal, sizes = ideal_corners(views, camera), np.array([len(v.points) for v in views])
    stack = _stack(views, ideal, camera)
    poses, owner = _refine(stack, sizes, start_poses(views, ideal)), np.arange(len(views))
    other, rows = mirrored(stack.points, sizes, poses.C)
    r, _, _ = _residuals(stack.take(rows), other)
    noise = np.maximum(poses.sse[rows], 1e-3)
    worth = np.einsum("nkm,nkm->n", r, r) < _HOPELESS_START * noise
    rows, other, limit = rows[worth], other[worth], _HOPELESS * noise[worth]
    if not len(rows):
        return poses, owner
    poses = poses.joined(_refine(stack.take(rows), sizes[rows], other, limit))
    owner = np.concatenate([owner, rows])
    order = np.lexsort((poses.sse, owner))
    first = np.r_[True, np.diff(owner[order]) > 0]
    best = order[first]
    keep = first | (poses.sse[order] < _AMBIGUOUS * poses.sse[best][owner[order]])
    same = np.linalg.norm(poses.C[order] - poses.C[best][owner[order]], axis=(1, 2)) < 1e-6
    order = order[keep & (first | ~same)]
    return poses.take(order), owner[order]
