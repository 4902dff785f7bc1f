"""The links of a UR arm as lines in the base, for what stands between a tracker and its reflector.

The upper arm runs beside the shoulder by about d4, the forearm by about a fifth of it: within 20 mm of the
maker's drawings from ur3e to ur16e, within 60 mm for the others. The hand and the tool are left out, for a
reflector sits there.
"""

import numpy as np

from cell.poses import Array
from fakes.world.arm.kinematics import Chain, dh_parameters

_FOREARM_BESIDE = 0.2


class ArmShape:
    """``lines(q)`` is (5, 2, 3) m: column, upper arm, forearm, first and second wrist."""

    def __init__(self, model: str, true: Chain) -> None:
        _, d, a, _ = dh_parameters(model)
        self._true = true
        across, along = true.screws[1, 3:], np.array([1.0, 0.0, 0.0])
        shoulder = np.array([0.0, 0.0, d[0]])
        upper = shoulder + d[3] * across
        elbow = shoulder + a[1] * along
        forearm = elbow + _FOREARM_BESIDE * d[3] * across
        wrist = elbow + a[2] * along
        wrist_1, wrist_2 = wrist + d[3] * across, wrist + d[3] * across + d[4] * true.screws[4, 3:]
        # Both ends with all joints at zero, and the joints that carry them.
        self._links: list[tuple[int, Array]] = [
            (0, np.array([np.zeros(3), shoulder])),
            (2, np.array([upper, upper + a[1] * along])),
            (3, np.array([forearm, forearm + a[2] * along])),
            (3, np.array([forearm + a[2] * along, wrist_1])),
            (4, np.array([wrist_1, wrist_2])),
        ]

    def lines(self, q: Array) -> Array:
        """Both ends of each link's axis in the base for joints ``q`` (6,) rad."""
        carried = self._true.partial(q)
        return np.array([ends @ carried[i][:3, :3].T + carried[i][:3, 3] for i, ends in self._links])
