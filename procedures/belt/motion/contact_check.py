"""How far items were beside the tool's set-points when it touched them, as counts of after show it, and how
far they may have been off by all that is known."""

from math import sqrt

import numpy as np

from calibration.belt.tracking import ItemTrack
from cell.poses import Array
from procedures.belt.contact_uncertainty import ContactBudget, ContactError, Touch, together
from procedures.belt.item_tracking import BeltWatch
from procedures.belt.items import Item

_NOTED_M = 0.001


class ContactCheck:
    """Of one run. A set-point is sent before the belt comes to where it was forecast to be: whatever the belt
    does meanwhile shows here, and what pictures told later; constant errors of camera, belt calibration and
    arm do not. ``budget`` knows what these leave open; None: nobody asks, as by a method that predicts no
    uncertainty."""

    def __init__(self, budget: ContactBudget | None = None) -> None:
        self.off_m: list[float] = []
        self.stated: list[ContactError] = []
        self.budget = budget
        self._t, self._xy = np.inf, np.zeros(2)
        self._track: ItemTrack | None = None

    def begin(self) -> None:
        """A descent begins."""
        self._t, self._track = np.inf, None

    def expect(self, t: float, touches: float, xy: Array, track: ItemTrack | None) -> None:
        """As planned at ``t`` by where ``track`` has the item the tool comes down to its face at ``touches``,
        at ``xy`` (2,) in the base, m. Of plans that follow each other the last one before the contact
        holds."""
        if t < self._t:
            self._t, self._xy, self._track = touches, np.array(xy, dtype=float), track

    def end(self, item: Item, watch: BeltWatch, following: Array | None) -> None:
        """The grip of ``item`` is over; nothing when its place is not known any more. ``following`` (2, 2)
        m^2: see :class:`procedures.belt.motion.arm_following.ArmFollowing`."""
        if not np.isfinite(self._t) or (track := watch.track(item)) is None:
            return
        if self.budget is not None and self._track is not None:
            stated = self.budget.of(Touch(self._t, self._xy, self._track), watch.seen_at(item), following)
            self.stated.append(stated)
            item.contact = stated.as_dict()
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

    @property
    def together(self) -> ContactError | None:
        """What is stated of all contacts; None before the first, or where nobody asks."""
        return together(self.stated)

    @property
    def largest_95_m(self) -> float | None:
        """The largest figure of a contact; None before the first."""
        return max((stated.r95_m for stated in self.stated), default=None)

    @property
    def not_covered(self) -> list[str] | None:
        """What these figures leave out, in words; None without one."""
        return self.budget.not_covered() if self.budget is not None and self.stated else None

    @property
    def assumed(self) -> list[str] | None:
        """What these figures have by an assumption, in words; None without a figure."""
        return self.budget.assumed() if self.budget is not None and self.stated else None
