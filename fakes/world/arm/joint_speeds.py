"""How fast the joints of UR's arms turn at most.

Source: UR's user manuals, as UR's own description package lists them (Universal_Robots_ROS2_Description,
``config/*/joint_limits.yaml``; of the UR15 its URDF). Of the UR8 Long none was found.
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


def fastest_joints(model: str) -> Array:
    """(6,) rad/s; ``ValueError`` for an arm of which it is not known."""
    if model not in _DEG_S:
        raise ValueError(
            f"how fast the joints of a {model} turn was not found published; give what its controller "
            "allows, as world.arm.controller_limits.joint_speeds_rad_s"
        )
    return np.deg2rad(_DEG_S[model])
