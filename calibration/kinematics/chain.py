"""Serial chains of any joints in DH or Hayati form, with a coupling between motors and links.

A link is ``Rz(theta) Tz(d) Tx(a) Rx(alpha) Ry(beta)`` (Denavit and Hartenberg 1955; the convention in which
Universal Robots publishes its arms; the last turn is that of Hayati and Mirmirani 1985, which keeps the form
regular where two axes are near parallel). The joints as a controller counts them, ``q``, reach the links
through a matrix: a parallelogram arm, whose motors sit in the base, is then a serial chain too.

Poses are plain 4x4 arrays: a chain is evaluated thousands of times while a plan is made. A calibration asks
for many poses and their derivatives at a time, and walks along the chain with vectors of (3, n) instead: the
sums then run along memory.
"""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from calibration.kinematics.joint_errors import JointErrors
from cell.poses import Array

_UNIT = np.eye(4)
_LOWER, _UPPER = [7, 2, 3], [5, 6, 1]  # of a rotation's elements, those that the axis comes from


@dataclass(frozen=True, eq=False)
class Walk:
    """Where every frame of a chain is, for n joint vectors.

    ``x``, ``y``, ``z`` (m + 1, 3, n) are the axes and ``o`` (m + 1, 3, n) the origins (m) of the base and the
    frame after every link, in the base; ``turned`` (m, 3, n) is the x axis before the link's last turn, about
    which ``alpha`` turns and along which ``a`` runs.
    """

    x: Array
    y: Array
    z: Array
    o: Array
    turned: Array

    def point(self, tool: Array) -> Array:
        """(3, n): points fixed in the last frame, ``tool`` (3, 1 or n), in the base."""
        out: Array = self.o[-1] + self.x[-1] * tool[0] + self.y[-1] * tool[1] + self.z[-1] * tool[2]
        return out


@dataclass(frozen=True, eq=False)
class SerialChain:
    """m links in metres and radians, (m,) each; ``beta`` is zero where it is left out.

    ``coupling`` (m, j) takes the controller's joints ``q`` (j,) to what is added to ``theta`` of a turning
    link or to ``d`` of a ``sliding`` one (m,); a rigid link has a row of zeros. Left out, each joint turns
    its own link. ``errors`` is how far joints turn beyond ``q``.
    """

    theta: Array
    d: Array
    a: Array
    alpha: Array
    beta: Array = field(default_factory=lambda: np.zeros(0))
    sliding: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, dtype=bool))
    coupling: Array = field(default_factory=lambda: np.zeros((0, 0)))
    errors: JointErrors | None = None

    def __post_init__(self) -> None:
        m = len(self.theta)
        usual_ones = {"beta": np.zeros(m), "sliding": np.zeros(m, dtype=bool), "coupling": np.eye(m)}
        for name, usual in usual_ones.items():
            if not len(getattr(self, name)):
                object.__setattr__(self, name, usual)

    @property
    def joints(self) -> int:
        """Number of the controller's joints, j."""
        return int(self.coupling.shape[1])

    @cached_property
    def plain(self) -> bool:
        """Whether each joint turns its own link, and nothing else."""
        return np.array_equal(self.coupling, np.eye(len(self.theta))) and not self.sliding.any()

    def frames(self, Q: Array) -> Array:
        """(n, m + 1, 4, 4): the base and the frame after every link, for ``Q`` (n, j), rad or m."""
        links = self._links(np.asarray(Q, dtype=float))
        out = np.empty((len(links), links.shape[1] + 1, 4, 4))
        out[:, 0] = _UNIT
        for i in range(links.shape[1]):
            np.matmul(out[:, i], links[:, i], out=out[:, i + 1])
        return out

    def flange(self, Q: Array) -> Array:
        """(n, 4, 4): the last frame in the base."""
        out: Array = self.frames(Q)[:, -1]
        return out

    def jacobians(self, frames: Array) -> Array:
        """(n, 6, j): the last frame's velocity over its angular velocity in the base, per unit of ``q``.

        ``frames`` are those of the joints, by :meth:`frames`.

        Column i of a turning link is ``z x (p_end - p)`` over ``z``, that of a sliding one ``z`` over zero
        (Siciliano et al., Robotics, 3.1.3). Joint errors change it by some 1e-4 of itself, which is left out.
        """
        z = frames[:, :-1, :3, 2].swapaxes(1, 2)
        arm = (frames[:, -1:, :3, 3] - frames[:, :-1, :3, 3]).swapaxes(1, 2)
        out = np.empty((len(frames), 6, z.shape[2]))
        for k, (i, j) in enumerate(((1, 2), (2, 0), (0, 1))):  # np.cross takes as long as all else
            out[:, k] = z[:, i] * arm[:, j] - z[:, j] * arm[:, i]
        out[:, 3:] = z
        if self.plain:
            return out
        out[:, :3, self.sliding], out[:, 3:, self.sliding] = z[:, :, self.sliding], 0.0
        return np.asarray(out @ self.coupling)

    def walk(self, Q: Array) -> Walk:
        """Every frame for ``Q`` (n, j)."""
        m, n = len(self.theta), len(Q)
        moved = self._moved(Q).T
        slide = self.sliding[:, None]
        angle = self.theta[:, None] + np.where(slide, 0.0, moved)
        d = self.d[:, None] + np.where(slide, moved, 0.0)
        c, s = np.cos(angle), np.sin(angle)
        ca, sa, cb, sb = np.cos(self.alpha), np.sin(self.alpha), np.cos(self.beta), np.sin(self.beta)
        x, y, z, o = (np.empty((m + 1, 3, n)) for _ in range(4))
        o[0] = 0.0
        for k, axis in enumerate((x, y, z)):
            axis[0] = np.eye(3)[k, :, None]
        turned = np.empty((m, 3, n))
        for i in range(m):
            u = np.add(c[i] * x[i], s[i] * y[i], out=turned[i])
            v = c[i] * y[i] - s[i] * x[i]
            np.add(o[i], d[i] * z[i], out=o[i + 1])
            if self.a[i] != 0.0:
                o[i + 1] += self.a[i] * u
            np.add(ca[i] * v, sa[i] * z[i], out=y[i + 1])
            w = ca[i] * z[i] - sa[i] * v
            if self.beta[i] == 0.0:
                x[i + 1], z[i + 1] = u, w
            else:
                np.subtract(cb[i] * u, sb[i] * w, out=x[i + 1])
                np.add(cb[i] * w, sb[i] * u, out=z[i + 1])
        return Walk(x, y, z, o, turned)

    def _moved(self, Q: Array) -> Array:
        """(n, m): what the joints ``Q`` (n, j) add to ``theta`` or ``d`` of every link."""
        actual = Q if self.errors is None else self.errors.actual(Q)
        return actual if self.plain else np.asarray(actual @ self.coupling.T)

    def _links(self, Q: Array) -> Array:
        """(n, m, 4, 4): the turn about z mixes the first two rows of what is fixed in a link."""
        moved, fixed = self._moved(Q), self._fixed
        angle = (moved if self.plain else np.where(self.sliding, 0.0, moved)) + self.theta
        c, s = np.cos(angle)[..., None], np.sin(angle)[..., None]
        out = np.empty((*angle.shape, 4, 4))
        out[..., 0, :] = c * fixed[:, 0] - s * fixed[:, 1]
        out[..., 1, :] = s * fixed[:, 0] + c * fixed[:, 1]
        out[..., 2:, :] = fixed[:, 2:]
        if not self.plain:
            out[..., 2, 3] += np.where(self.sliding, moved, 0.0)
        return out

    @cached_property
    def _fixed(self) -> Array:
        """(m, 4, 4): ``Tz(d) Tx(a) Rx(alpha) Ry(beta)`` of every link."""
        ca, sa = np.cos(self.alpha), np.sin(self.alpha)
        cb, sb = np.cos(self.beta), np.sin(self.beta)
        out = np.zeros((len(self.d), 4, 4))
        out[:, 0, 0], out[:, 0, 2], out[:, 0, 3] = cb, sb, self.a
        out[:, 1, 0], out[:, 1, 1], out[:, 1, 2] = sa * sb, ca, -sa * cb
        out[:, 2, 0], out[:, 2, 1], out[:, 2, 2], out[:, 2, 3] = -ca * sb, sa, ca * cb, self.d
        out[:, 3, 3] = 1.0
        return out


def pose_gap(goal: Array, reached: Array) -> Array:
    """(n, 6): what takes ``reached`` (n, 4, 4) to ``goal`` (n, 4, 4), in the base: metres, rotation vector.

    The rotation vector is exact up to a half turn, where its axis comes from the symmetric part.
    """
    out = np.empty((len(reached), 6))
    np.subtract(goal[:, :3, 3], reached[:, :3, 3], out=out[:, :3])
    R = np.matmul(goal[:, :3, :3], reached[:, :3, :3].swapaxes(1, 2))
    elements = R.reshape(-1, 9)
    sine = 0.5 * (elements[:, _LOWER] - elements[:, _UPPER])
    size = np.sqrt(np.einsum("ni,ni->n", sine, sine))
    cosine = 0.5 * (np.einsum("nii->n", R) - 1.0)
    angle = np.arctan2(size, cosine)
    np.multiply(sine, (angle / np.maximum(size, 1e-300))[:, None], out=out[:, 3:])
    if size.min(initial=1.0) <= 1e-6:
        out[size <= 1e-12, 3:] = sine[size <= 1e-12]
        for k in np.flatnonzero((size <= 1e-6) & (cosine < 0.0)):
            out[k, 3:] = angle[k] * _half_turn_axis(R[k])
    return out


def _half_turn_axis(R: Array) -> Array:
    """Axis of a rotation by almost pi: the dominant column of (R + R^T)/2 + I, up to sign."""
    columns = 0.5 * (R + R.T) + np.eye(3)
    column: Array = columns[:, int(np.argmax(np.diag(columns)))]
    return column / np.linalg.norm(column)


def cross(a: Array, b: Array) -> Array:
    """Cross products of (..., 3, n) and (..., 3, n); NumPy's own copies far more."""
    out = np.empty(np.broadcast_shapes(a.shape, b.shape))
    for k, (i, j) in enumerate(((1, 2), (2, 0), (0, 1))):
        np.multiply(a[..., i, :], b[..., j, :], out=out[..., k, :])
        out[..., k, :] -= a[..., j, :] * b[..., i, :]
    return out
