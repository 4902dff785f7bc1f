"""The links of an arm as lines in the base, for what stands between a tracker and its reflector.

A UR arm's upper arm runs beside the shoulder by about d4, its forearm by about a fifth of that: within 20 mm
of the maker's drawings from ur3e to ur16e, within 60 mm for the others. The hand and the tool are left out,
for a reflector sits there.
"""

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import RigidTransform

from cell.formats.robot import Serial6Robot
from cell.poses import Array
from fakes.world.arm.kinematics import Chain, dh_parameters
from fakes.world.arm.true_arm import TrueArm

_FOREARM_BESIDE = 0.2


class ArmShape:
    """``lines(q)`` is (k, 2, 3) m: both ends of each link's axis in the base for joints ``q`` (6,) rad.

    ``links``: how many joints carry a link, and both its ends (2, 3) in the base with all joints at zero.
    """

    def __init__(self, true: TrueArm | Chain, links: Sequence[tuple[int, Array]]) -> None:
        self._true, self._links = true, tuple(links)

    def lines(self, q: Array) -> Array:
        carried = self._true.partial(q)
        return np.array([ends @ carried[i][:3, :3].T + carried[i][:3, 3] for i, ends in self._links])


def ur_shape(model: str, true: TrueArm | Chain) -> ArmShape:
    """Column, upper arm, forearm, first and second wrist of a UR arm."""
    _, d, a, _ = dh_parameters(model)
    across, along = true.screws[1, 3:], np.array([1.0, 0.0, 0.0])
    shoulder = np.array([0.0, 0.0, d[0]])
    upper = shoulder + d[3] * across
    elbow = shoulder + a[1] * along
    forearm = elbow + _FOREARM_BESIDE * d[3] * across
    wrist = elbow + a[2] * along
    wrist_1, wrist_2 = wrist + d[3] * across, wrist + d[3] * across + d[4] * true.screws[4, 3:]
    return ArmShape(
        true,
        [
            (0, np.array([np.zeros(3), shoulder])),
            (2, np.array([upper, upper + a[1] * along])),
            (3, np.array([forearm, forearm + a[2] * along])),
            (3, np.array([forearm + a[2] * along, wrist_1])),
            (4, np.array([wrist_1, wrist_2])),
        ],
    )


def capsule_shape(robot: Serial6Robot, at_zero: Sequence[RigidTransform], true: TrueArm) -> ArmShape:
    """The axes of the capsules of a ROBOT; ``at_zero`` are its base and the frames after every joint."""
    return ArmShape(true, [(c.joints, at_zero[c.joints].apply([c.p0, c.p1])) for c in robot.capsules])
