"""The arms of Universal Robots: published lengths, joint ranges and approximate link shapes.

Lengths: Universal Robots, "DH Parameters for calculations of kinematics and dynamics"
(universal-robots.com/articles/ur/application-installation/dh-parameters-for-calculations-of-kinematics-and-dynamics).
UR7e and UR12e have the lengths of UR5e and UR10e; UR8 Long, UR15 and UR18 differ in both long links only.
Those of the UR8 Long are also in the maker's ROS description (``config/ur8long/default_kinematics.yaml``).

Joints turn by two turns in all. The elbow is held to one: past half a turn either way the forearm meets the
upper arm, so nothing is lost (the maker's ROS description limits it in the same way).

Offsets of upper arm and forearm along the shoulder axis are those of the maker's ROS description. Radii are
approximate: the housings of each size class (joint sizes 0..4), rounded up so that a capsule covers the link.

Offsets and radii of UR8 Long, UR15 and UR18 come from the maker's drawings (STL) of the links of a UR8 Long.
Their bounds, in mm:

- Radii about the joints' axes: base with its connector 126, shoulder 81, upper arm 79, forearm 63, wrists 51.
- Offset of the upper arm: the shoulder's face is at 109 along the shoulder axis, and the upper arm's middle
  112 outside that face, so at 221.
- Offset of the forearm: the elbow's face is at 134 along the same direction, and the forearm's middle 88
  inside that face, so at 46.

The maker's ROS description has the same drawings of base, shoulder and wrists for UR8 Long, UR15 and UR18. Of
all three it has the shoulder's face and the elbow's face within 9 mm of these.
"""

from dataclasses import dataclass

import numpy as np

from cell.poses import Array


@dataclass(frozen=True)
class LinkRadii:
    """Capsule radii of one size class, m."""

    base: float
    shoulder: float
    upper_arm: float
    forearm: float
    wrist: float


@dataclass(frozen=True)
class UrModel:
    """Lengths of one arm in the names of the DH table, m."""

    d1: float
    a2: float
    a3: float
    d4: float
    d5: float
    d6: float
    shoulder_offset: float  # upper arm's middle, along the shoulder axis
    elbow_offset: float  # forearm's middle, along the same direction
    radii: LinkRadii

    @property
    def d(self) -> Array:
        return np.array([self.d1, 0.0, 0.0, self.d4, self.d5, self.d6])

    @property
    def a(self) -> Array:
        return np.array([0.0, self.a2, self.a3, 0.0, 0.0, 0.0])


ALPHA = np.array([np.pi / 2, 0.0, 0.0, np.pi / 2, -np.pi / 2, 0.0])
JOINT_LIMITS = (
    np.array([[-2.0, 2.0], [-2.0, 2.0], [-1.0, 1.0], [-2.0, 2.0], [-2.0, 2.0], [-2.0, 2.0]]) * np.pi
)

_SMALL = LinkRadii(base=0.065, shoulder=0.062, upper_arm=0.055, forearm=0.045, wrist=0.042)
_MEDIUM = LinkRadii(base=0.076, shoulder=0.072, upper_arm=0.062, forearm=0.055, wrist=0.048)
_LARGE = LinkRadii(base=0.096, shoulder=0.090, upper_arm=0.080, forearm=0.065, wrist=0.055)
_EXTRA = LinkRadii(base=0.125, shoulder=0.120, upper_arm=0.105, forearm=0.085, wrist=0.070)

_LONG = LinkRadii(base=0.127, shoulder=0.082, upper_arm=0.080, forearm=0.065, wrist=0.052)

_UR5E = UrModel(0.1625, -0.425, -0.3922, 0.1333, 0.0997, 0.0996, 0.138, 0.007, _MEDIUM)
_UR10E = UrModel(0.1807, -0.6127, -0.57155, 0.17415, 0.11985, 0.11655, 0.1762, 0.0393, _LARGE)

UR_MODELS: dict[str, UrModel] = {
    "ur3": UrModel(0.1519, -0.24365, -0.21325, 0.11235, 0.08535, 0.0819, 0.1198, 0.0275, _SMALL),
    "ur5": UrModel(0.089159, -0.425, -0.39225, 0.10915, 0.09465, 0.0823, 0.13585, 0.0165, _MEDIUM),
    "ur10": UrModel(0.1273, -0.612, -0.5723, 0.163941, 0.1157, 0.0922, 0.220941, 0.0491, _LARGE),
    "ur3e": UrModel(0.15185, -0.24355, -0.2132, 0.13105, 0.08535, 0.0921, 0.120, 0.027, _SMALL),
    "ur5e": _UR5E,
    "ur7e": _UR5E,
    "ur8long": UrModel(0.2186, -0.8989, -0.7149, 0.1824, 0.1361, 0.1434, 0.221, 0.046, _LONG),
    "ur10e": _UR10E,
    "ur12e": _UR10E,
    "ur15": UrModel(0.2186, -0.6475, -0.5164, 0.1824, 0.1361, 0.1434, 0.221, 0.046, _LONG),
    "ur16e": UrModel(0.1807, -0.4784, -0.36, 0.17415, 0.11985, 0.11655, 0.1762, 0.0393, _LARGE),
    "ur18": UrModel(0.2186, -0.475, -0.3389, 0.1824, 0.1361, 0.1434, 0.221, 0.046, _LONG),
    "ur20": UrModel(0.2363, -0.862, -0.7287, 0.201, 0.1593, 0.1543, 0.260, 0.043, _EXTRA),
    "ur30": UrModel(0.2363, -0.637, -0.5037, 0.201, 0.1593, 0.1543, 0.260, 0.043, _EXTRA),
}
