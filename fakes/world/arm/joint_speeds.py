"""How fast the joints of UR's arms turn at most.

Source: UR's user manuals, as UR's own description package lists them (Universal_Robots_ROS2_Description,
``config/*/joint_limits.yaml``; of the UR15 its URDF). An arm that is not listed has no limit of its own here.
"""

import numpy as np

from cell.poses import Array

_DEG_S: dict[str, tuple[float, float, float, float, float, float]] = {
    "ur3": (180, 180, 180, 360, 360, 360),
    "ur5": (180, 180, 180, 180, 180, 180),
    "ur10": (120, 120, 180, 180, 180, 180),
    "ur3e": (180, 180, 180, 360, 360, 360),
    "ur5e": (180, 180, 180, 180, 180, 180),
    "ur10e": (120, 120, 180, 180, 180, 180),
    "ur16e": (120, 120, 180, 180, 180, 180),
    "ur15": (180, 180, 240, 300, 300, 300),
    "ur18": (180, 180, 240, 300, 300, 300),
    "ur20": (120, 120, 150, 210, 210, 210),
    "ur30": (120, 120, 150, 210, 210, 210),
}
UNLISTED_RAD_S = 3.5


def fastest_joints(model: str) -> Array:
    """(6,) rad/s."""
    degrees = _DEG_S.get(model)
    return np.full(6, UNLISTED_RAD_S) if degrees is None else np.deg2rad(degrees)
