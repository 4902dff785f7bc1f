"""How far items were beside the tool's set-points when it touched them, as counts of after show it."""

from math import sqrt

import numpy as np

from cell.poses import Array
from procedures.belt.item_tracking import BeltWatch
from procedures.belt.items import Item

_NOTED_M = 0.001


class ContactCheck:
    """Of one run. A set-point is sent before the belt comes to where it was forecast to be: whatever the belt
    does meanwhile shows here, and what pictures told later; constant errors of camera, belt calibration and
    arm do not."""

    def __init__(self) -> None:
        self.off_m: list[float] = []
        self._t, self._xy = np.inf, np.zeros(2)

    def begin(self) -> None:
        """A descent begins."""
        self._t = np.inf

    def expect(self, t: float, touches: float, xy: Array) -> None:
        """As planned at ``t`` the tool comes down to the item's face at ``touches``, at ``xy`` (2,) in the
        base, m. Of plans that follow each other the last one before the contact holds."""
        if t < self._t:
            self._t, self._xy = touches, np.array(xy, dtype=float)

    def end(self, item: Item, watch: BeltWatch) -> None:
        """The grip of ``item`` is over; nothing when its place is not known any more."""
        if not np.isfinite(self._t) or (track := watch.track(item)) is None:
            return
        off = float(np.linalg.norm(track.was_at(self._t) - self._xy))
        self.off_m.append(off)
        if off > _NOTED_M:
            item.note(self._t, f"{1e3 * off:.1f} mm beside the tool at contact")

    @property
    def rms_m(self) -> float | None:
        """Of all contacts; None before the first."""
        return sqrt(float(np.mean(np.square(self.off_m)))) if self.off_m else None

    @property
    def largest_m(self) -> float | None:
        """None before the first contact."""
        return max(self.off_m, default=None)
