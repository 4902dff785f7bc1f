"""The joints along a straight line of the TCP, found sample by sample.

A real-time loop spreads the samples over its cycles; whoever has time takes them all at once.
"""

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import RigidTransform, Rotation

from cell.poses import Array
from fakes._profile import Trapezoid
from fakes.kinematics import Chain
from fakes.segments import PathMove

ROTATION_ARM_M = 0.25  # a turn of one radian on the spot takes as long as this way
_PIECES = 24


class LinearPath:
    """TCP on a straight line from where ``q_start`` has it, with the rotation about one axis.

    ``length`` is the longer of the translation (m) and ``ROTATION_ARM_M`` times the turn. Joints are exact
    at the samples and a spline between.
    """

    def __init__(
        self, believed: Chain, q_start: Array, T_base_tcp: RigidTransform, T_flange_tcp: RigidTransform
    ) -> None:
        self._believed, self._tcp_flange = believed, T_flange_tcp.inv()
        self._start = believed.forward(q_start) * T_flange_tcp
        self._way = T_base_tcp.translation - self._start.translation
        self._turn = (self._start.rotation.inv() * T_base_tcp.rotation).as_rotvec()
        way, turn = float(np.linalg.norm(self._way)), float(np.linalg.norm(self._turn))
        self.length = max(way, ROTATION_ARM_M * turn)
        self._joints = [np.asarray(q_start, dtype=float)]

    @property
    def complete(self) -> bool:
        """True once every sample is found."""
        return len(self._joints) > _PIECES

    def sample(self) -> None:
        """Find the next sample; :class:`fakes.kinematics.UnreachableError` when there is none."""
        f = len(self._joints) / _PIECES
        pose = RigidTransform.from_components(
            self._start.translation + f * self._way,
            self._start.rotation * Rotation.from_rotvec(f * self._turn),
        )
        last, before = self._joints[-1], self._joints[max(len(self._joints) - 2, 0)]
        self._joints.append(self._believed.inverse(pose * self._tcp_flange, 2.0 * last - before))

    def segment(self, t: float, v: float, a: float) -> PathMove:
        """The move from ``t`` on with ``v`` (m/s) and ``a`` (m/s^2) along the way; needs all samples."""
        spline = CubicSpline(np.linspace(0.0, self.length, _PIECES + 1), np.array(self._joints))
        return PathMove(t, spline.x, spline.c, Trapezoid(self.length, v, a))
