"""The force on a part that is put into a slot, in closed form: chamfer, faces, two-point contact, wedging.

Whitney, Quasi-static assembly of compliantly supported rigid parts, 1982: a part beside its slot by less than
the chamfer is led in by it; in the slot it touches at one place, or at two when it is tilted; touching at two
within ``friction`` times its width of the mouth it wedges, and pushing harder does not help. Arm and part are
elastic, so every force is a stiffness times what overlaps.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cell.poses import Array


@dataclass(frozen=True)
class SlotShape:
    """Lengths in m: ``room`` (2,) is half of what the opening is larger than the part; ``end`` is how deep
    the front can go. Stiffnesses in N/m."""

    part: Sequence[float]
    room: Array
    chamfer: float
    end: float
    friction: float
    stiffness: float
    side_stiffness: float


@dataclass(frozen=True)
class Touch:
    """``force`` (3,) N on the part in the slot's frame; ``on_face``: its front meets the plate and not the
    opening; ``wedged``: it is held at two places and goes no deeper."""

    force: Array
    on_face: bool = False
    wedged: bool = False


_NOTHING = Touch(np.zeros(3))


def touch(T_slot_part: Array, shape: SlotShape, inward: float) -> Touch:
    """Of a part with its front at ``T_slot_part`` (4, 4); ``inward``: above 0 while it goes in, 0 at rest."""
    x, y, depth = T_slot_part[:3, 3]
    if depth <= min(0.0, shape.end):
        return _NOTHING
    if depth <= 0.0:  # something stands out of the slot
        return Touch(_along(-shape.stiffness * (depth - shape.end)))
    R = T_slot_part[:3, :3]
    tilt = R[:2, 2] / R[2, 2]  # how much farther to the side per depth
    # turned about the slot's axis a rectangle needs more room
    more = abs(R[1, 0]) * 0.5 * np.array([shape.part[1], shape.part[0]])
    front = np.array([x, y])
    mouth = front - tilt * depth
    over_front, over_mouth = (np.maximum(np.abs(p) + more - shape.room, 0.0) for p in (front, mouth))
    if over_mouth.max() > shape.chamfer:
        return Touch(_along(-shape.stiffness * depth), on_face=True)
    across = np.zeros(2)
    for p, over in ((front, over_front), (mouth, over_mouth)):
        across -= shape.side_stiffness * over * np.sign(p)
    pressed = shape.side_stiffness * float((over_front + over_mouth).sum())
    along = -np.sign(inward) * shape.friction * pressed
    riding = depth < over_mouth.max()  # on the chamfer
    if riding and inward > 0.0:
        along = -pressed * (1.0 + shape.friction) / (1.0 - shape.friction)
    wedge = _wedged_from(front, mouth, tilt, over_front, over_mouth, shape)
    wedged = wedge is not None and depth >= wedge and inward >= 0.0
    if wedge is not None and wedged:
        along -= shape.stiffness * (depth - wedge)
    if depth > shape.end:
        along -= shape.stiffness * (depth - shape.end)
    return Touch(np.array([*across, along]), wedged=wedged)


def relaxed(T_slot_part: Array, shape: SlotShape) -> Array:
    """Where a part (4, 4) comes to rest that was pressed against the slot and is let go: (4, 4).

    It springs back from the end and from a side that it leans on; one that is tilted between two sides stays.
    """
    T = T_slot_part.copy()
    T[2, 3] = min(T[2, 3], shape.end)
    R, depth = T[:3, :3], T[2, 3]
    more = abs(R[1, 0]) * 0.5 * np.array([shape.part[1], shape.part[0]])
    front = T[:2, 3]
    ends = np.array([front, front - R[:2, 2] / R[2, 2] * depth])
    over = np.maximum(np.abs(ends) + more - shape.room, 0.0) * np.sign(ends)
    T[:2, 3] -= np.where(over[0] * over[1] >= 0.0, over[np.argmax(np.abs(over), axis=0), [0, 1]], 0.0)
    return T


def _wedged_from(
    front: Array, mouth: Array, tilt: Array, over_front: Array, over_mouth: Array, shape: SlotShape
) -> float | None:
    """The depth at which two places of a side touch first, where that is within the friction's reach."""
    found = []
    for k in range(2):
        opposite = front[k] * mouth[k] < 0.0
        if not (opposite and over_front[k] > 0.0 and over_mouth[k] > 0.0):
            continue
        first = 2.0 * float(shape.room[k]) / abs(float(tilt[k]))
        if first < shape.friction * shape.part[k]:
            found.append(first)
    return min(found, default=None)


def _along(force: float) -> Array:
    return np.array([0.0, 0.0, force])
