"""The tool as it truly is: capsules on a mounting that can be bent at a moment in time."""

from bisect import bisect_right
from collections.abc import Callable, Sequence
from functools import lru_cache
from math import inf

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform, Rotation

from cell.poses import Array, from_pose6
from fakes.world.arm.truth import ToolTruth

Bend = tuple[float, tuple[float, ...]]  # since when, and the shift (m) and tilt (rad) in the flange


class ToolShape:
    """The true tool as a function of time.

    A bend moves the tool's point by a shift and turns the tool about it by a rotation vector, both in the
    flange frame and both counted from the nominal tool.
    """

    def __init__(self, t: float, truth: ToolTruth) -> None:
        self.T_nominal = from_pose6(truth.T_flange_tool)
        lean = Rotation.from_rotvec([*truth.lean_rad, 0.0]).as_matrix()
        self.axes: Array = np.array([(c.from_, c.to) for c in truth.shape], dtype=float) @ lean.T  # (n, 2, 3)
        self.radii: Array = np.array([c.radius_m for c in truth.shape])
        self.listeners: list[Callable[[Bend], None]] = []
        self._bends: list[Bend] = [(t, (0.0,) * 6)]
        self._bent = lru_cache(8)(self._bent_frame)
        self._ends = lru_cache(8)(self._bent_ends)

    def bend(self, t: float, shift_m: ArrayLike, tilt_rad: ArrayLike = (0.0, 0.0, 0.0)) -> None:
        """From ``t`` on the tool is ``shift_m`` (3,) and ``tilt_rad`` (3,) off the nominal tool."""
        values = np.concatenate([np.asarray(shift_m, dtype=float), np.asarray(tilt_rad, dtype=float)])
        if values.shape != (6,) or not np.all(np.isfinite(values)):
            raise ValueError("a bend is three lengths and a rotation vector of three angles")
        self.follow((t, tuple(values.tolist())))

    def straighten(self, t: float) -> None:
        """From ``t`` on the tool has its nominal shape."""
        self.follow((t, (0.0,) * 6))

    def follow(self, bend: Bend) -> None:
        """Do what the tool of the mirrored world did; bends planned for later are forgotten."""
        self._bends[bisect_right(self._bends, bend[0], key=_since) :] = [bend]
        for listener in tuple(self.listeners):
            listener(bend)

    def T_flange_tool_at(self, t: float) -> RigidTransform:
        """``T_flange_tool`` as it truly is at ``t``."""
        return self._bent(self._bend_at(t))

    def ends_at(self, t: float) -> tuple[Array, float]:
        """Both ends of each capsule's axis in the flange at ``t``, (n, 2, 3) m, and how far out they are."""
        return self._ends(self._bend_at(t))

    def next_bend(self, t: float) -> float:
        """When the tool is bent next after ``t``; inf for never."""
        i = bisect_right(self._bends, t, key=_since)
        return self._bends[i][0] if i < len(self._bends) else inf

    def bent_at(self, t: float) -> bool:
        """Whether the tool changes at this very time."""
        i = bisect_right(self._bends, t, key=_since) - 1
        return i >= 0 and self._bends[i][0] == t

    def history(self) -> list[Bend]:
        """All bends, oldest first."""
        return list(self._bends)

    def load(self, history: Sequence[Bend]) -> None:
        """Become a copy of the tool whose :meth:`history` this is."""
        self._bends = list(history)

    def _bend_at(self, t: float) -> tuple[float, ...]:
        return self._bends[max(bisect_right(self._bends, t, key=_since) - 1, 0)][1]

    def _bent_ends(self, bend: tuple[float, ...]) -> tuple[Array, float]:
        points: Array = self._bent(bend).apply(self.axes.reshape(-1, 3))
        points.flags.writeable = False
        return points.reshape(self.axes.shape), float(np.linalg.norm(points, axis=1).max())

    def _bent_frame(self, bend: tuple[float, ...]) -> RigidTransform:
        nominal = self.T_nominal
        turned = Rotation.from_rotvec(bend[3:]) * nominal.rotation
        return RigidTransform.from_components(nominal.translation + np.array(bend[:3]), turned)


def _since(bend: Bend) -> float:
    return bend[0]
