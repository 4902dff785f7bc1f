"""The joints along a straight line of the TCP, found sample by sample.

A real-time loop spreads the samples over its cycles; whoever has time takes them all at once.
"""

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from cell.poses import Array
from fakes.cubic_spline import coefficients
from fakes.world.arm.kinematics import Chain, rotation_vector
from fakes.world.arm.profile import Trapezoid
from fakes.world.arm.segments import PathMove

ROTATION_ARM_M = 0.25  # a turn of one radian on the spot takes as long as this way
_STEP_M, _FEWEST, _MOST = 0.01, 5, 24  # the spline between samples is then right to 10 nm


class LinearPath:
    """TCP on a straight line from where ``q_start`` has it, with the rotation about one axis.

    ``length`` is the longer of the translation (m) and ``ROTATION_ARM_M`` times the turn. Joints are exact
    at the samples and a spline between.
    """

    def __init__(
        self, believed: Chain, q_start: Array, T_base_tcp: RigidTransform, T_flange_tcp: RigidTransform
    ) -> None:
        self._believed = believed
        start, end = believed.matrix(q_start) @ T_flange_tcp.as_matrix(), T_base_tcp.as_matrix()
        way, turn = end[:3, 3] - start[:3, 3], rotation_vector(start[:3, :3].T @ end[:3, :3])
        self.length = max(float(np.linalg.norm(way)), ROTATION_ARM_M * float(np.linalg.norm(turn)))
        self._pieces = int(np.clip(np.ceil(self.length / _STEP_M), _FEWEST, _MOST))
        f = np.linspace(0.0, 1.0, self._pieces + 1)[:, None]
        goals = np.tile(np.eye(4), (self._pieces + 1, 1, 1))
        goals[:, :3, :3] = start[:3, :3] @ Rotation.from_rotvec(f * turn).as_matrix()
        goals[:, :3, 3] = start[:3, 3] + f * way
        self._goals = goals @ T_flange_tcp.inv().as_matrix()
        self._joints = [np.asarray(q_start, dtype=float)]

    @property
    def complete(self) -> bool:
        """True once every sample is found."""
        return len(self._joints) > self._pieces

    def sample(self) -> None:
        """Find the next sample; :class:`fakes.world.arm.kinematics.UnreachableError` when there is none."""
        k = len(self._joints)
        a, b, c = (self._joints[max(k - i, 0)] for i in (1, 2, 3))
        near = 3.0 * a - 3.0 * b + c if k >= 3 else 2.0 * a - b
        self._joints.append(self._believed.joints_at(self._goals[k], near))

    def segment(self, t: float, v: float, a: float) -> PathMove:
        """The move from ``t`` on with ``v`` (m/s) and ``a`` (m/s^2) along the way; needs all samples."""
        knots = np.linspace(0.0, self.length, self._pieces + 1)
        pieces = coefficients(self.length / self._pieces, np.array(self._joints))
        return PathMove(t, knots, pieces, Trapezoid(self.length, v, a))
