"""The place where items are put down: each lies there until it is carried off."""

from collections.abc import Callable
from math import floor

import numpy as np

from cell.poses import Array
from fakes.world.belt.gripper import Gripper
from fakes.world.belt.item_truth import PlaceTruth

_BESIDE_M = 0.02  # of a light barrier, at which the tool breaks it
_PARTS = 8  # of the filter's time, between looks: what comes and goes within one counts as nothing
_LONGEST = 100  # times the filter's, for which a level that never lasts is looked back on


class Place:
    """What lies where ``gripper`` has put items down, at times in s on the twin's clock.

    ``tool_point`` gives the tool's point (3,) in the base, which a light barrier sees as well.
    """

    def __init__(
        self, truth: PlaceTruth, gripper: Gripper, tool_point: Callable[[float], Array], t0: float = 0.0
    ) -> None:
        self.truth, self._gripper, self._tool_point, self._t0 = truth, gripper, tool_point, t0
        self._blocked: list[float] = []

    def block(self, t: float) -> None:
        """Something else is put there at ``t``, and carried off as items are."""
        self._blocked.append(t)

    def is_clear(self, t: float) -> bool:
        """What the module of the input says at ``t``: late by its scan and its filter."""
        scan_s, filter_s = self.truth.scan_s, self.truth.filter_s
        if scan_s:
            t = self._t0 + floor((t - self._t0) / scan_s + 1e-9) * scan_s
        level, since = self._is_free(t), t
        if not filter_s:
            return level
        step = filter_s / _PARTS
        for k in range(1, _PARTS * _LONGEST):
            before = t - k * step
            if self._is_free(before) != level:
                level, since = not level, before
            elif since - before >= filter_s - 1e-9:
                break
        return level

    def _is_free(self, t: float) -> bool:
        """What the sensor sees at ``t``."""
        return self._lying(t) == 0 and not self._tool_is_seen(t)

    def _lying(self, t: float) -> int:
        """How many things lie there at ``t``."""
        self._gripper.settle(t)
        since = [*(put.t for put in self._gripper.put_down), *self._blocked]
        return sum(put <= t < put + self.truth.carried_off_s for put in since)

    def _tool_is_seen(self, t: float) -> bool:
        """Whether the tool breaks the light barrier at ``t``."""
        if self.truth.beam is None:
            return False
        x, y, z = self._tool_point(t) - np.array(self.truth.beam)
        return bool(np.hypot(x, y) <= _BESIDE_M and z < 0.0)
