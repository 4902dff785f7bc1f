"""How far the joints of an arm turn beyond what its encoders read: by their gears, and under its weight.

A gear turns its joint too far by a wave once and one twice a turn of the joint. Joints 2 and 3 give way under
the upper arm and the forearm in proportion to the torque of their weights, which goes with the cosine of the
link's angle to the horizontal; gravity is the base's -z. What follows the forearm is light and short.
Source of the form: Whitney, Lozinski and Rourke, Industrial Robot Forward Calibration Method and Results,
ASME J. Dyn. Syst. 1986.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cell.poses import Array
from fakes.world.arm.kinematics import JOINTS, Chain
from fakes.world.arm.truth import JointErrorsTruth

_DRAWN_FOR = 0x6EA2  # keeps these draws apart from others of the same seed


@dataclass(frozen=True, eq=False)
class JointErrors:
    """t waves over the j joints: ``joint`` (t,), from 0, turns ``sin`` times the sine and ``cos`` times the
    cosine of ``of @ q`` further than it reads; ``of`` (t, j), amplitudes (t,) in rad."""

    names: tuple[str, ...]
    joint: NDArray[np.int64]
    of: Array
    sin: Array
    cos: Array

    def actual(self, q: Array) -> Array:
        """Joints (..., j) rad at which the arm truly stands when its encoders read ``q`` (..., j)."""
        angle = q @ self.of.T
        waves = self.sin * np.sin(angle) + self.cos * np.cos(angle)
        turned: Array = q + waves @ np.eye(self.of.shape[1])[self.joint]
        return turned

    @property
    def steepest(self) -> float:
        """Bound on how fast all errors together change with any one joint, rad/rad."""
        size = np.hypot(self.sin, self.cos)
        return float((size @ np.abs(self.of)).max())

    def told(self) -> list[dict[str, Any]]:
        """As a ROBOT of docs/data-sets.md lists them in ``joint_errors``."""
        rows = zip(self.names, self.joint.tolist(), self.of.tolist(), self.sin, self.cos, strict=True)
        return [
            {"name": name, "joint": joint + 1, "of": of, "sin": float(sin), "cos": float(cos)}
            for name, joint, of, sin, cos in rows
        ]


def joint_errors(truth: JointErrorsTruth, links: Chain, seed: int) -> JointErrors | None:
    """Those of a scenario for an arm of these ``links``; None where the scenario has none."""
    if not (truth.gear_once_rad or truth.gear_twice_rad or any(truth.sag_rad)):
        return None
    sizes = (1, truth.gear_once_rad), (2, truth.gear_twice_rad)
    phases = np.random.default_rng([seed, _DRAWN_FOR]).uniform(0.0, 2.0 * np.pi, (JOINTS, 2))
    one = np.eye(JOINTS)
    rows = [
        (f"gear{j + 1}.{times}", j, times * one[j], size * np.cos(phase), size * np.sin(phase))
        for j in range(JOINTS)
        for (times, size), phase in zip(sizes, phases[j], strict=True)
    ]
    upper, fore, turning = _loads(links)
    forearm = one[1] + turning * one[2]
    for name, joint, of, (level, upright), size in (
        ("sag2.upper", 1, one[1], upper, truth.sag_rad[0]),
        ("sag2.fore", 1, forearm, fore, truth.sag_rad[1]),
        ("sag3.fore", 2, forearm, fore, turning * truth.sag_rad[2]),
    ):
        rows.append((name, joint, of, size * upright, size * level))
    names, joints, of, sin, cos = zip(*rows, strict=True)
    return JointErrors(names, np.array(joints), np.array(of), np.array(sin), np.array(cos))


def _loads(links: Chain) -> tuple[Array, Array, float]:
    """Torques of upper arm and forearm about joint 2, by cosine and sine (2,) of how far each has turned, as
    shares of that of a level link; and +1 where joint 3 turns the way joint 2 does, else -1."""
    w, third = links.screws[1, 3:], links.screws[2, 3:]
    shoulder, elbow = (np.cross(screw[3:], screw[:3]) for screw in links.screws[1:3])
    wrist = _meeting(*links.screws[3:5])  # where the hand begins, of UR's arms and of spherical wrists alike
    links_at_zero = elbow - shoulder, wrist - elbow
    upper, fore = (np.array([_torque(w, link), _torque(w, np.cross(w, link))]) for link in links_at_zero)
    return upper, fore, float(np.sign(w @ third))


def _torque(w: Array, link: Array) -> float:
    """Of a weight at the end of ``link`` (3,) about the axis ``w`` (3,); 1 is that of a level link."""
    across = _off(w) @ link
    return float(np.cross(across, [0.0, 0.0, -1.0]) @ w / np.linalg.norm(across))


def _meeting(one: Array, other: Array) -> Array:
    """(3,) the point that is nearest to the axes of two screws (6,), m."""
    A = np.concatenate([_off(screw[3:]) for screw in (one, other)])
    b = np.concatenate([np.cross(screw[3:], screw[:3]) for screw in (one, other)])
    point: Array = np.linalg.lstsq(A, b, rcond=None)[0]
    return point


def _off(w: Array) -> Array:
    """(3, 3) what of a vector lies across the axis ``w`` (3,)."""
    out: Array = np.eye(3) - np.outer(w, w)
    return out
