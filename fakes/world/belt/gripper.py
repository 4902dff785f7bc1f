"""The gripper as it truly is: what its fingers close on, what they hold, and how well they met it.

Closing takes time, and whether it takes an item depends on where the tool is at its end. So commands are
events in time, and what came of them is found when somebody asks about a time after that end.
"""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any, Protocol

import numpy as np

from cell.poses import Array
from fakes.world.belt.item_truth import GripperTruth

_SPAN_S = 0.002  # over which the motion of tool and item is compared
_LOOK_BACK_S = 4.0
_LIFTED_S = 0.1  # a tool that comes down somewhere else has been up for longer
_TOUCH_M = 0.0005  # this far above an item's face the tool is in contact


@dataclass(frozen=True)
class Contact:
    """One closing. ``off_m`` is the horizontal distance of the tool's point and the item's grasp point when
    the tool first came down to its face, at ``t_contact``, or when the fingers took it above that; None when
    neither happened."""

    t: float
    item: int | None
    taken: bool
    t_contact: float | None = None
    off_m: tuple[float, float] | None = None
    distance_m: float | None = None
    slide_m_s: float | None = None


@dataclass(frozen=True)
class PutDown:
    """The fingers opened at ``t`` and let ``item`` go; the tool's point was at ``at``, in the base, m."""

    item: int
    t: float
    at: tuple[float, float, float]


class Takeable(Protocol):
    """What lies about for fingers to close on, by number."""

    def nearest(self, t: float, point: Array) -> tuple[int, Array] | None:
        """What has its grasp point closest to ``point`` (3,), and that grasp point (3,), in the base."""
        ...

    def grasp_point(self, number: int, t: float) -> Array: ...
    def take(self, number: int, t: float) -> None: ...
    def let_go(self, number: int, t: float) -> None: ...


class Gripper:
    """``tool_point(t)`` (3,) is the true tool's point in the base."""

    def __init__(
        self, truth: GripperTruth, items: Takeable | None, tool_point: Callable[[float], Array]
    ) -> None:
        self.truth, self._items, self._tool = truth, items, tool_point
        self.contacts: list[Contact] = []
        self.put_down: list[PutDown] = []
        self._closed = False
        self._due: list[tuple[float, bool]] = []  # when what was commanded has happened
        self._held: list[tuple[float, int | None]] = []

    def command(self, t: float, close: bool) -> None:
        """The output changes at ``t``; the same level again does nothing.

        Fingers on their way turn back, and what they had not done by then does not happen any more.
        """
        if close is self._closed:
            return
        self.settle(t)
        self._closed = close
        self._due = [(t + (self.truth.close_s if close else self.truth.open_s), close)]

    @property
    def closed(self) -> bool:
        """What was commanded last."""
        return self._closed

    def give(self, t: float, item: int) -> None:
        """Somebody has the fingers close on ``item``, which is between them at ``t``."""
        self.settle(t)
        self._closed, self._due = True, []
        self._held.append((t, item))

    def holds(self, t: float) -> int | None:
        """The item that is held at ``t``, or None."""
        self.settle(t)
        return next((item for since, item in reversed(self._held) if since <= t), None)

    def settle(self, t: float) -> None:
        """Let happen what was due until ``t``."""
        while self._due and self._due[0][0] <= t:
            at, close = self._due.pop(0)
            if close and self._held and self._held[-1][1] is not None:
                continue  # they turned back before they had let it go
            if not close and (held := self._let_go(at)) is not None:
                x, y, z = self._tool(at)
                self.put_down.append(PutDown(held, at, (float(x), float(y), float(z))))
            self._held.append((at, self._close(at) if close else None))

    def empty(self, t: float) -> int | None:
        """Somebody takes out what is held at ``t``, and the fingers stay as they are; returns what it was."""
        held = self.holds(t)
        if held is not None:
            self._let_go(t)
            self._held.append((t, None))
        return held

    def _let_go(self, t: float) -> int | None:
        held = self._held[-1][1] if self._held else None
        if held is not None and self._items is not None:
            self._items.let_go(held, t)
        return held

    def truth_at(self, t: float) -> dict[str, Any]:
        """What is held, and every closing so far, as plain values."""
        return {"holds": self.holds(t), "contacts": [asdict(contact) for contact in self.contacts]}

    def _close(self, t: float) -> int | None:
        """The fingers meet at ``t``: what is between them."""
        tip = self._tool(t)
        near = None if self._items is None else self._items.nearest(t, tip)
        if self._items is None or near is None:
            self.contacts.append(Contact(t, None, False))
            return None
        number, place = near
        before = self._items.grasp_point(number, t - _SPAN_S)
        slide = float(np.linalg.norm((tip - self._tool(t - _SPAN_S)) - (place - before))) / _SPAN_S
        distance = float(np.linalg.norm(tip - place))
        taken = distance <= self.truth.within_m and slide <= self.truth.below_m_s
        t_contact, off = self._touch(self._items, t, number)
        if taken and off is None:  # a tool that is too high meets the item with its fingers
            t_contact, off = t, (float(tip[0] - place[0]), float(tip[1] - place[1]))
        self.contacts.append(Contact(t, number, taken, t_contact, off, distance, slide))
        if taken:
            self._items.take(number, t)
        return number if taken else None

    def _touch(
        self, items: Takeable, t: float, number: int
    ) -> tuple[float | None, tuple[float, float] | None]:
        """When the tool first came down to the item's face before ``t``, and how far beside its middle."""

        def gap(at: float) -> Array:
            return self._tool(at) - items.grasp_point(number, at)

        touching, before = t, t
        step = _SPAN_S
        while (off := gap(before))[2] <= _TOUCH_M:  # a controller's cycle pays for this: few looks
            touching, before, step = before, before - step, min(2.0 * step, _LIFTED_S)
            if t - before > _LOOK_BACK_S:
                break
        if before == t:
            return None, None
        while touching - before > 0.5 * _SPAN_S and off[2] > _TOUCH_M:
            middle = 0.5 * (touching + before)
            touching, before = (middle, before) if gap(middle)[2] <= _TOUCH_M else (touching, middle)
        off = gap(touching)
        return touching, (float(off[0]), float(off[1]))
