"""Pose and velocity of the TCP in plain floats: what every control cycle reports.

Small arrays would cost several times as much, and every client of the controller waits for this.
"""

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import RigidTransform

from cell.poses import Array, from_pose6
from fakes.world.arm.kinematics import Chain, rotation_vector_of

Floats = list[float]
_Rows = tuple[float, ...]  # the upper three rows of a 4x4 matrix, one after the other


class TcpKinematics:
    """The TCP of ``chain`` as a function of joints, joint speeds and the tool's offset.

    With a frame ``A_i`` on each axis, ``z`` along it, the product of exponentials is
    ``A_1 Rz(q1) (A_1^-1 A_2) Rz(q2) ... (A_6^-1 M)``: constant transforms between turns about ``z``. Each
    joint's axis, which the velocity needs, comes with the pose.
    """

    def __init__(self, chain: Chain) -> None:
        frames = [_frame_on(screw) for screw in chain.screws]
        links = [a.inv() * b for a, b in pairwise(frames)]
        self._base = _rows(frames[0])
        self._links = [_rows(link) for link in links]
        self._last_axis_to_flange = frames[-1].inv() * RigidTransform.from_matrix(chain.M)
        self._tool: tuple[float, ...] | None = None
        self._tip: _Rows = ()
        self._asked: tuple[Floats, Floats, tuple[float, ...]] | None = None
        self._answer: tuple[Floats, Floats] = ([], [])

    def at(self, q: Floats, qd: Floats, offset6: tuple[float, ...]) -> tuple[Floats, Floats]:
        """Pose (6,) m and rotation vector, and velocity (6,) m/s and rad/s, of the TCP in the base.

        ``q`` (6,) rad, ``qd`` (6,) rad/s, ``offset6`` the TCP in the flange. The last answer is kept: an arm
        at rest is asked the same in every cycle.
        """
        asked = q, qd, offset6
        if asked != self._asked:
            self._answer, self._asked = self._compute(q, qd, offset6), asked
        return self._answer

    def _compute(self, q: Floats, qd: Floats, offset6: tuple[float, ...]) -> tuple[Floats, Floats]:
        if offset6 != self._tool:
            self._tip = _rows(self._last_axis_to_flange * from_pose6(offset6))
            self._tool = offset6
        axes = []
        xx, yx, zx, px, xy, yy, zy, py, xz, yz, zz, pz = self._base
        for angle, (a, b, c, u, d, e, f, v, g, h, i, w) in zip(q, (*self._links, self._tip), strict=True):
            axes.append((zx, zy, zz, px, py, pz))
            cos, sin = math.cos(angle), math.sin(angle)
            xx, yx = cos * xx + sin * yx, cos * yx - sin * xx
            xy, yy = cos * xy + sin * yy, cos * yy - sin * xy
            xz, yz = cos * xz + sin * yz, cos * yz - sin * xz
            px, py, pz = (
                px + xx * u + yx * v + zx * w,
                py + xy * u + yy * v + zy * w,
                pz + xz * u + yz * v + zz * w,
            )
            xx, yx, zx = xx * a + yx * d + zx * g, xx * b + yx * e + zx * h, xx * c + yx * f + zx * i
            xy, yy, zy = xy * a + yy * d + zy * g, xy * b + yy * e + zy * h, xy * c + yy * f + zy * i
            xz, yz, zz = xz * a + yz * d + zz * g, xz * b + yz * e + zz * h, xz * c + yz * f + zz * i
        pose = [px, py, pz, *rotation_vector_of([[xx, yx, zx], [xy, yy, zy], [xz, yz, zz]])]
        return pose, _velocity(axes, qd, px, py, pz)


def _velocity(axes: Sequence[tuple[float, ...]], qd: Floats, px: float, py: float, pz: float) -> Floats:
    vx = vy = vz = wx = wy = wz = 0.0
    for rate, (ax, ay, az, ox, oy, oz) in zip(qd, axes, strict=True):
        if rate:
            ax, ay, az = rate * ax, rate * ay, rate * az
            lx, ly, lz = px - ox, py - oy, pz - oz
            vx += ay * lz - az * ly
            vy += az * lx - ax * lz
            vz += ax * ly - ay * lx
            wx += ax
            wy += ay
            wz += az
    return [vx, vy, vz, wx, wy, wz]


def _frame_on(screw: Array) -> RigidTransform:
    """A frame with the axis of ``screw`` (6,) as z, and the axis' point nearest to the base's as origin."""
    moment, z = screw[:3], screw[3:]
    x = np.cross(np.eye(3)[int(np.argmin(np.abs(z)))], z)
    x /= np.linalg.norm(x)
    matrix = np.eye(4)
    matrix[:3] = np.stack([x, np.cross(z, x), z, np.cross(z, moment)], axis=1)
    return RigidTransform.from_matrix(matrix)


def _rows(T: RigidTransform) -> _Rows:
    return tuple(T.as_matrix()[:3].ravel().tolist())
