"""From the lift to leaving the place: over it, down when it is clear, the gripper open, and up again."""

from collections.abc import Callable
from enum import Enum, auto

import numpy as np

from calibration.belt.pursuit import FixedPoint
from cell.poses import Array
from procedures.belt.config import BeltTrackingConfig
from procedures.belt.motion.blend import blend_for
from procedures.belt.motion.gripper_work import GripperWork
from procedures.belt.motion.place_clear import PlaceClear
from procedures.belt.motion.places import Places
from procedures.belt.motion.tool_path import LEAD_S, STEP_S, ToolPath, pursuit_limits

ROUND_M = 0.5e-3  # of a height that is reached


class Put(Enum):
    """What a step of putting an item down has come to."""

    UNDER_WAY = auto()
    BLOCKED = auto()  # at rest above a place that is not clear, with the item
    EMPTY = auto()  # in the place, and the gripper does not hold the item any more
    OPENED = auto()  # the gripper let go
    LEFT = auto()  # clear of the place: the tool may go anywhere


class PuttingDown:
    """One item after the other, each at the next of ``places``, step by step as the picker's phases are.

    ``clear`` is asked until the tool is so low that the sensor may see tool or item, and not after that.
    """

    def __init__(
        self,
        config: BeltTrackingConfig,
        path: ToolPath,
        gripper: GripperWork,
        places: Places,
        clear: PlaceClear,
        wait: FixedPoint,
    ) -> None:
        self._path, self._gripper, self._places, self._clear = path, gripper, places, clear
        self._above = np.array([0.0, 0.0, config.above_m, 0.0])
        self._look_above_m, self._wait = config.look_above_m, wait
        self._highest_m = config.items.max_height_m
        # In a grid, what hangs in the gripper comes down straight beside what lies around.
        least_m = config.items.max_height_m if config.place_grid else 0.0
        self._blend = blend_for(config, pursuit_limits(config.limits), least_m)
        self._place = FixedPoint(np.zeros(4))
        self._step: Callable[[float], Put] = self._over

    @property
    def lets_go(self) -> bool:
        """Whether the tool is at rest in the place, with fingers that were told to open."""
        return self._step == self._release

    def begin(self, t: float) -> None:
        """Set out for the next place at ``t``: one of a grid from so high that others are crossed above what
        lies there."""
        self._place = self._places.here
        if self._places.is_grid and not self._is_high(t):
            self._step = self._climb
            self._path.begin(t, self._at_level(self._path.at(t).p), np.zeros(4))
        else:
            self._set_out(t)

    def step(self, t: float) -> Put:
        """Decide about the way from ``t`` on."""
        return self._step(t)

    def _is_high(self, t: float) -> bool:
        return float(self._path.at(t).p[2] - self._place.p[2]) >= self._highest_m - ROUND_M

    def _at_level(self, p: Array) -> FixedPoint:
        """``p`` (4,) at the height of the level ways above the place."""
        return FixedPoint(np.array([*p[:2], self._places.level_m, p[3]]))

    def _climb(self, t: float) -> Put:
        if self._is_high(t) or t >= self._path.t1:
            self._set_out(t)
        return Put.UNDER_WAY

    def _set_out(self, t: float) -> None:
        self._step = self._over
        self._path.begin(t, self._place, self._above)

    def _over(self, t: float) -> Put:
        self._path.go(t, self._place, self._above)
        if self._path.t1 - t > self._blend.lead_s:
            return Put.UNDER_WAY
        if self._clear.obstacle() is not None:
            return Put.BLOCKED if t >= self._path.t1 else Put.UNDER_WAY
        self._path.at_full_speed()
        self._step = self._down
        return Put.UNDER_WAY

    def _down(self, t: float) -> Put:
        height_m = float(self._path.at(t).p[2] - self._place.p[2])
        if height_m >= self._look_above_m and self._clear.taken_on_the_way_down():
            self._path.rise(t, self._above)
            self._step = self._rise
            return Put.UNDER_WAY
        self._path.go(t, self._place, np.zeros(4), apart=True)
        if self._path.t1 - t > 0.5 * STEP_S:
            return Put.UNDER_WAY
        if holds := self._gripper.holding():
            self._places.take()
        self._gripper.begin_release(t - LEAD_S)
        self._step = self._release
        return Put.UNDER_WAY if holds else Put.EMPTY

    def _rise(self, t: float) -> Put:
        """Back to rest above the place, where it is waited for: a sensor that sees the tool would otherwise
        send it up and down without end."""
        return Put.BLOCKED if t >= self._path.t1 else Put.UNDER_WAY

    def _release(self, t: float) -> Put:
        if not self._gripper.opened():
            return Put.UNDER_WAY
        self._step = self._leave
        return Put.OPENED

    def _leave(self, t: float) -> Put:
        self._path.go(t, self._place, self._above)
        if not self._path.has_risen(t, float(self._place.p[2]), self._blend):
            return Put.UNDER_WAY
        if not self._places.is_grid or self._wait.p[2] >= self._places.level_m:
            return Put.LEFT
        self._path.begin(t, self._at_level(self._wait.p), np.zeros(4))
        self._step = self._leave_grid
        return Put.UNDER_WAY

    def _leave_grid(self, t: float) -> Put:
        """Level until no place is below: a waiting pose that is lower pulls the tool down at once."""
        over = self._places.is_over(self._path.at(t).p)
        return Put.UNDER_WAY if over and t < self._path.t1 else Put.LEFT
