"""Serial chains of turning joints in Denavit-Hartenberg form, for many joint vectors at a time.

A link is ``Rz(theta) Tz(d) Tx(a) Rx(alpha) Ry(beta)`` (Denavit and Hartenberg 1955; the convention in which
Universal Robots publishes its arms, without ``beta``, which is that of Hayati and Mirmirani 1985), and
``theta`` is the joint angle plus a constant. Matrices are plain 4x4 arrays here: a chain is evaluated
thousands of times while a plan is made.
"""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from calibration.kinematics.joint_errors import JointErrors
from cell.poses import Array

_UNIT = np.eye(4)


@dataclass(frozen=True, eq=False)
class DhChain:
    """``theta``, ``d``, ``a``, ``alpha``: (j,) each, rad and m; joint i turns about z of frame i - 1.

    ``beta`` (j,) may be left out, and is zero then. ``errors`` is how far joints turn beyond what they read.
    """

    theta: Array
    d: Array
    a: Array
    alpha: Array
    beta: Array = field(default_factory=lambda: np.zeros(0))
    errors: JointErrors | None = None

    def frames(self, Q: Array) -> Array:
        """(n, j + 1, 4, 4): the base and the frame after every joint, for ``Q`` (n, j) rad."""
        links = self._links(Q)
        out = np.empty((len(Q), links.shape[1] + 1, 4, 4))
        out[:, 0] = _UNIT
        for i in range(links.shape[1]):
            np.matmul(out[:, i], links[:, i], out=out[:, i + 1])
        return out

    def jacobians(self, frames: Array) -> Array:
        """(n, 6, j): the last frame's velocity (m/s) over its angular velocity (rad/s), in the base.

        Column i of a revolute joint is ``z x (p_end - p)`` over ``z`` (Siciliano et al., Robotics, 3.1.3).
        """
        z = frames[:, :-1, :3, 2].swapaxes(1, 2)
        arm = (frames[:, -1:, :3, 3] - frames[:, :-1, :3, 3]).swapaxes(1, 2)
        out = np.empty((len(frames), 6, z.shape[2]))
        for k, (i, j) in enumerate(((1, 2), (2, 0), (0, 1))):  # np.cross takes as long as all else
            out[:, k] = z[:, i] * arm[:, j] - z[:, j] * arm[:, i]
        out[:, 3:] = z
        return out

    def _links(self, Q: Array) -> Array:
        """(n, j, 4, 4): the turn about z mixes the first two rows of what is fixed in a link."""
        angle = (Q if self.errors is None else self.errors.actual(Q)) + self.theta
        c, s = np.cos(angle)[..., None], np.sin(angle)[..., None]
        fixed = self._fixed
        out = np.empty((*Q.shape, 4, 4))
        out[..., 0, :] = c * fixed[:, 0] - s * fixed[:, 1]
        out[..., 1, :] = s * fixed[:, 0] + c * fixed[:, 1]
        out[..., 2:, :] = fixed[:, 2:]
        return out

    @cached_property
    def _fixed(self) -> Array:
        """(j, 4, 4): ``Tz(d) Tx(a) Rx(alpha) Ry(beta)`` of every link."""
        ca, sa = np.cos(self.alpha), np.sin(self.alpha)
        beta = self.beta if len(self.beta) else np.zeros_like(self.alpha)
        cb, sb = np.cos(beta), np.sin(beta)
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
    out[:, :3] = goal[:, :3, 3] - reached[:, :3, 3]
    R = goal[:, :3, :3] @ reached[:, :3, :3].swapaxes(1, 2)
    sine = out[:, 3:]
    sine[:, 0] = 0.5 * (R[:, 2, 1] - R[:, 1, 2])
    sine[:, 1] = 0.5 * (R[:, 0, 2] - R[:, 2, 0])
    sine[:, 2] = 0.5 * (R[:, 1, 0] - R[:, 0, 1])
    size = np.sqrt(np.einsum("ni,ni->n", sine, sine))
    cosine = 0.5 * (R[:, 0, 0] + R[:, 1, 1] + R[:, 2, 2] - 1.0)
    angle = np.arctan2(size, cosine)
    half_turns = np.flatnonzero((size <= 1e-6) & (cosine < 0.0))
    sine *= np.where(size > 1e-12, angle / np.maximum(size, 1e-300), 1.0)[:, None]
    for k in half_turns:
        out[k, 3:] = angle[k] * _half_turn_axis(R[k])
    return out


def _half_turn_axis(R: Array) -> Array:
    """Axis of a rotation by almost pi: the dominant column of (R + R^T)/2 + I, up to sign."""
    columns = 0.5 * (R + R.T) + np.eye(3)
    column: Array = columns[:, int(np.argmax(np.diag(columns)))]
    return column / np.linalg.norm(column)
