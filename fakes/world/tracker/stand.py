"""Where a tracker truly stands: it creeps, and somebody may push it."""

from bisect import bisect_right

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform, Rotation

from cell.poses import Array, from_pose6
from fakes.world.tracker.truth import TrackerTruth

_HOUR_S = 3600.0
_Placed = tuple[float, Array, Array]  # since when, where, and how it is turned


class Stand:
    """The tracker's true pose as a function of time."""

    def __init__(self, truth: TrackerTruth, t0: float) -> None:
        self._t0 = t0
        first = from_pose6(truth.T_base_tracker)
        self._creep = np.array(truth.drift_m_h) / _HOUR_S, np.array(truth.drift_rad_h) / _HOUR_S
        self._turns = bool(np.any(self._creep[1]))
        self._creeps = self._turns or bool(np.any(self._creep[0]))
        self._placed: list[_Placed] = [(-np.inf, first.translation, first.rotation.as_matrix())]

    def move(self, t: float, shift_m: ArrayLike, turn_rad: ArrayLike = (0.0, 0.0, 0.0)) -> None:
        """From ``t`` on it stands ``shift_m`` (3,) further and is turned about itself, both in the base."""
        _, where, how = self._placed[-1]
        turned = Rotation.from_rotvec(np.asarray(turn_rad, dtype=float)).as_matrix() @ how
        self._placed.append((t, where + np.asarray(shift_m, dtype=float), turned))

    def frame(self, t: float) -> tuple[Array, Array]:
        """Origin (3,) m and axes (3, 3, columns) of the tracker frame in the base at ``t``."""
        _, where, how = self._placed[self._pushed(t)]
        shift, turn = self._creep
        age = t - self._t0
        if self._turns:
            how = Rotation.from_rotvec(turn * age).as_matrix() @ how
        return where + shift * age, how

    def rests(self, since: float, t: float) -> bool:
        """Whether it stands at ``t`` as it did ``since``: it does not creep, and nobody pushed it."""
        return not self._creeps and self._pushed(since) == self._pushed(t)

    def _pushed(self, t: float) -> int:
        """How often it was pushed by ``t``."""
        return max(bisect_right(self._placed, t, key=_since) - 1, 0)

    def at(self, t: float) -> RigidTransform:
        """``T_base_tracker`` at ``t``."""
        where, how = self.frame(t)
        return RigidTransform.from_components(where, Rotation.from_matrix(how))


def _since(placed: _Placed) -> float:
    return placed[0]
