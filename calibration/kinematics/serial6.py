"""A six-axis arm from a file: any chain of turning joints, with joint ranges and capsules of its own.

The inverse has no closed form here: Newton steps from starts spread evenly over the joint ranges find the
branches. The spread is that of a Sobol sequence, so the same pose gives the same branches every time.
"""

from functools import cache

import numpy as np

from calibration.kinematics.chain import SerialChain
from calibration.kinematics.chain_arm import ChainArm, rows
from calibration.kinematics.inverse import distinct, polish
from cell.arm_model import LinkShape
from cell.even_points import even_points
from cell.formats.robot import Serial6Robot
from cell.poses import Array

_STARTS = 7  # two to this power; a spherical wrist has eight branches


class Serial6Arm(ChainArm):
    """The arm of a ROBOT of family ``serial6``; ``measured`` is the chain that a calibration found."""

    def __init__(self, robot: Serial6Robot, measured: SerialChain | None = None) -> None:
        theta, d, a, alpha = (
            np.array([getattr(link, key) for link in robot.links]) for key in ("theta", "d", "a", "alpha")
        )
        nominal = SerialChain(theta, d, a, alpha)
        capsules = robot.capsules
        self._robot = robot
        self._frame = np.array([c.joints for c in capsules])
        self._ends = np.array([[c.p0, c.p1] for c in capsules], dtype=float)
        super().__init__(
            robot.name,
            nominal,
            measured or nominal,
            np.array(robot.joint_limits, dtype=float),
            [LinkShape(c.name, c.radius_m, c.joints) for c in capsules],
            self._reach_after(nominal),
        )

    def measured(self, chain: SerialChain) -> "Serial6Arm":
        return Serial6Arm(self._robot, chain)

    def link_ends(self, Q: Array) -> Array:
        """Of the nominal chain, which has the metal."""
        frames = self._frames(self._nominal, rows(Q))[:, self._frame]
        out: Array = self._ends @ np.swapaxes(frames[..., :3, :3], -1, -2) + frames[..., None, :3, 3]
        return out

    def _branches(self, goal: Array) -> list[Array]:
        low, high = self._limits.T
        starts = low + (high - low) * _even()
        return distinct(list(polish(self._chain, goal, starts)))

    def _reach_after(self, nominal: SerialChain) -> Array:
        """(6,) m: an upper bound, the lengths of the links after each joint and what capsules add."""
        lengths = np.hypot(nominal.d, nominal.a)
        beyond = np.zeros(7)
        for frame, ends in zip(self._frame, self._ends, strict=True):
            beyond[frame] = max(beyond[frame], float(np.linalg.norm(ends, axis=1).max()))
        to_frame = np.concatenate([[0.0], np.cumsum(lengths)])
        return np.array(
            [max(to_frame[k] - to_frame[i] + beyond[k] for k in range(i + 1, 7)) for i in range(6)]
        )


@cache
def _even() -> Array:
    return even_points(6, _STARTS, seed=6)
