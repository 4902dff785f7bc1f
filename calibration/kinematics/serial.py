"""Serial chains of any joints in DH or Hayati form, with a coupling between motors and links.

A link is ``Rz(theta) Tz(d) Tx(a) Rx(alpha) Ry(beta)`` (Denavit and Hartenberg 1955; the last turn is that of
Hayati and Mirmirani 1985, which keeps the form regular where two axes are near parallel). The joints as a
controller counts them, ``q``, reach the links through a matrix: a parallelogram arm, whose motors sit in the
base, is then a serial chain too.

Vectors of many poses are kept as (3, n): the sums of a chain then run along memory.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.kinematics.joint_errors import JointErrors
from cell.poses import Array


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
    """m links in metres and radians, (m,) each.

    ``coupling`` (m, j) takes the controller's joints ``q`` (j,) to what is added to ``theta`` of a turning
    link or to ``d`` of a ``sliding`` one (m,); a rigid link has a row of zeros. ``errors`` is how far joints
    turn beyond ``q``.
    """

    theta: Array
    d: Array
    a: Array
    alpha: Array
    beta: Array
    sliding: NDArray[np.bool_]
    coupling: Array
    errors: JointErrors | None = None

    @property
    def joints(self) -> int:
        """Number of the controller's joints, j."""
        return int(self.coupling.shape[1])

    def walk(self, Q: Array) -> Walk:
        """Every frame for ``Q`` (n, j)."""
        m, n = len(self.theta), len(Q)
        moved = self.coupling @ (Q if self.errors is None else self.errors.actual(Q)).T
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

    def frames(self, Q: Array) -> Array:
        """(n, m + 1, 4, 4): the base and the frame after every link."""
        walk = self.walk(np.asarray(Q, dtype=float))
        out = np.zeros((len(Q), len(self.theta) + 1, 4, 4))
        for k, part in enumerate((walk.x, walk.y, walk.z, walk.o)):
            out[:, :, :3, k] = part.transpose(2, 0, 1)
        out[:, :, 3, 3] = 1.0
        return out

    def flange(self, Q: Array) -> Array:
        """(n, 4, 4): the last frame in the base."""
        out: Array = self.frames(Q)[:, -1]
        return out

    def jacobians(self, Q: Array) -> Array:
        """(n, 6, j): the last frame's velocity over its angular velocity in the base, per unit of ``q``.

        Joint errors change it by some 1e-4 of itself, which is left out.
        """
        walk = self.walk(np.asarray(Q, dtype=float))
        slide = self.sliding[:, None, None]
        z = walk.z[:-1]
        linear = np.where(slide, z, cross(z, walk.o[-1] - walk.o[:-1]))
        angular = np.where(slide, 0.0, z)
        links = np.concatenate([linear, angular], axis=1)  # (m, 6, n)
        out: Array = np.einsum("mj,mkn->nkj", self.coupling, links)
        return out


def cross(a: Array, b: Array) -> Array:
    """Cross products of (..., 3, n) and (..., 3, n); NumPy's own copies far more."""
    out = np.empty(np.broadcast_shapes(a.shape, b.shape))
    for k, (i, j) in enumerate(((1, 2), (2, 0), (0, 1))):
        np.multiply(a[..., i, :], b[..., j, :], out=out[..., k, :])
        out[..., k, :] -= a[..., j, :] * b[..., i, :]
    return out
