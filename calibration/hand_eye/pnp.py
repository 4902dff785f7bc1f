"""Pose of a target from its corners, for all images at once, with covariance.

Corners are turned into ideal (undistorted) coordinates once; a residual is carried back to pixels by the
local Jacobian of the distortion, which is exact to first order. What is left is a pinhole adjustment of six
numbers per image, done by Gauss-Newton on all images together.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from calibration.hand_eye import se3
from calibration.hand_eye.pnp_start import mirrored, planes, ridged, start_poses
from calibration.hand_eye.view_stack import Indices, ViewStack, view_stack
from calibration.hand_eye.views import CornerSet, blocks
from cell.devices import Intrinsics
from cell.poses import Array

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


def _residuals(stack: ViewStack, C: Array) -> tuple[Array, Array, Array]:
    """Whitened residuals (n, 2, m), measured minus predicted, ideal coordinates and inverse depths (n, m)."""
    p = C[:, :3, :3] @ stack.points + C[:, :3, 3:]
    iz = 1.0 / p[:, 2]
    flat = p[:, :2] * iz[:, None]
    off = stack.ideal - flat
    return stack.whiten[0] * off[:, :1] + stack.whiten[1] * off[:, 1:], flat, iz


def _jacobian(stack: ViewStack, flat: Array, iz: Array) -> Array:
    """d predicted / d xi for a perturbation on the left of C, whitened, (n, 6, 2 m).

    A corner at the depth z moves by ``f (t + w x q) / z`` where ``q = (x, y, 1) z`` is its place and f the
    derivative by the place, so the derivative by (t, w) is that of a force, ``(f, q x f) / z``.
    """
    x, y = flat[:, :1], flat[:, 1:]
    fx, fy = stack.whiten
    fz = -(fx * x + fy * y)
    n, _, m = flat.shape
    d = np.empty((n, 6, 2, m))
    for k, f in enumerate((fx, fy, fz)):
        np.multiply(f, iz[:, None], out=d[:, k])
    np.subtract(y * fz, fy, out=d[:, 3])
    np.subtract(fx, x * fz, out=d[:, 4])
    np.subtract(x * fy, y * fx, out=d[:, 5])
    return d.reshape(n, 6, 2 * m)


def _refine(everything: ViewStack, C: Array, give_up: Array | None = None) -> Poses:
    """Gauss-Newton from ``C`` (n, 4, 4), each view until its step is shorter than 1 % of its uncertainty.

    The step that is that short is taken too, so what remains is far smaller. A view whose squared error is
    still above ``give_up`` (n,) after two steps is left where it is.
    """
    n = len(C)
    C, cov, sse = C.copy(), np.zeros((n, 6, 6)), np.zeros(n)
    rows = np.arange(n)
    for iteration in range(_ITERATIONS):
        stack = everything.take(rows)
        r, flat, iz = _residuals(stack, C[rows])
        Jt = _jacobian(stack, flat, iz)
        r = r.reshape(len(rows), -1)
        g = (Jt @ r[..., None])[..., 0]
        inverse = np.linalg.inv(ridged(Jt @ np.swapaxes(Jt, 1, 2)))
        step = (inverse @ g[..., None])[..., 0]
        gain, before = np.vecdot(step, g), np.vecdot(r, r)
        C[rows] = se3.exp(step) @ C[rows]
        cov[rows], sse[rows] = inverse, np.maximum(before - gain, 0.0)
        variance = np.maximum(sse[rows] / np.maximum(2 * stack.sizes - 6, 1), 1e-4)
        active = gain > _SHORT**2 * variance
        if give_up is not None and iteration >= 1:
            hopeless = before >= give_up[rows]
            sse[rows[hopeless]] = before[hopeless]
            active &= ~hopeless
        rows = rows[active]
        if not len(rows):
            break
    return Poses(C, cov, sse, everything.sizes)


def refine_poses(views: Sequence[CornerSet], camera: Intrinsics, C: Array) -> Poses:
    """The pose of each view from ``C`` (n, 4, 4), which is near it: no second pose is looked for."""
    return _joined([_refine(view_stack(views[k], camera), C[k]) for k in blocks(len(views))])


def solve_pnp(views: Sequence[CornerSet], camera: Intrinsics) -> tuple[Poses, Indices]:
    """Every pose that explains a view, and the view (k,) that each belongs to, best one of each first.

    A planar target seen with little perspective has a second pose, mirrored in its line of sight, that fits
    nearly as well: it is kept, and the robot's motion decides. Every view needs four corners or more that do
    not lie on a line, and a start that is not NaN.
    """
    parts = blocks(len(views))
    poses, owners = zip(*(_solve_block(views[k], camera) for k in parts), strict=True)
    return _joined(poses), np.concatenate([own + k.start for own, k in zip(owners, parts, strict=True)])


def _solve_block(views: Sequence[CornerSet], camera: Intrinsics) -> tuple[Poses, Indices]:
    stack = view_stack(views, camera)
    flat = planes(stack)
    poses = _refine(stack, start_poses(views, stack, flat))
    other, rows = mirrored(flat, poses.C[flat.rows]), flat.rows
    r, _, _ = _residuals(stack.take(rows), other)
    noise = np.maximum(poses.sse[rows], 1e-3)
    worth = np.einsum("nkm,nkm->n", r, r) < _HOPELESS_START * noise
    rows, other, limit = rows[worth], other[worth], _HOPELESS * noise[worth]
    owner = np.arange(len(views))
    if not len(rows):
        return poses, owner
    poses = _joined([poses, _refine(stack.take(rows), other, limit)])
    owner = np.concatenate([owner, rows])
    order = np.lexsort((poses.sse, owner))
    first = np.r_[True, np.diff(owner[order]) > 0]
    best = order[first]
    keep = first | (poses.sse[order] < _AMBIGUOUS * poses.sse[best][owner[order]])
    same = np.linalg.norm(poses.C[order] - poses.C[best][owner[order]], axis=(1, 2)) < 1e-6
    order = order[keep & (first | ~same)]
    return poses.take(order), owner[order]


def _joined(parts: Sequence[Poses]) -> Poses:
    """Those of all parts, one after the other."""
    return Poses(*(np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(Poses)))
