"""The rack as it truly is: where its slots and parts are at any time, and what a held part feels.

A controller's cycle asks for the force, so poses are plain (4, 4) matrices in here.
"""

from bisect import bisect_right
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from cell.errors import present
from cell.poses import Array, from_pose6, to_pose6
from fakes.world.rack.contact import SlotShape, Touch, relaxed, touch
from fakes.world.rack.truth import RackTruth

PLATE_M = 0.04  # beyond the openings
_SPAN_S = 0.002  # over which it is seen whether a part goes in or out
_STANDS_M = 1e-7
_AWAY_M = 100.0  # in the hands of a person, and nowhere near
_IN_SLOT_M = 0.005  # across: a part nearer than this to a slot's axis is in it


@dataclass(frozen=True, eq=False)
class RackPlace:
    """From ``t`` on a part is ``T`` in the base, or in the flange while ``held``. It rests in ``slot``."""

    t: float
    held: bool
    T: Array
    slot: int | None = None


class Rack:
    """``flange(t)`` (4, 4) is the true ``T_base_flange``. Parts are numbered from 0, slots from 1."""

    def __init__(self, truth: RackTruth, flange: Callable[[float], Array], t: float) -> None:
        self.truth = truth
        self.T_base_rack = from_pose6(truth.T_base_rack)
        self.on_face: list[float] = []  # when a part's front met the plate
        self.listeners: list[Callable[[int, RackPlace], None]] = []
        self._flange_at: Callable[[float], Array] = lru_cache(4)(flange)
        self._slot = [self.T_base_rack.as_matrix() @ self._in_rack(n) for n in range(1, self.slots + 1)]
        self._into_slot = [np.linalg.inv(T) for T in self._slot]
        self._places: dict[int, list[RackPlace]] = {}
        for number, part in enumerate(truth.parts):
            T = from_pose6(part.T_base_part or [0.0] * 6).as_matrix()
            if part.slot is not None:
                T = self._slot[part.slot - 1] @ _along(truth.depth_m)
            self._places[number] = [RackPlace(t, False, T, self._slot_at(T))]
        self.handed = None if truth.handed is None else from_pose6(truth.handed)
        self._in_hands = len(truth.parts)
        if self.handed is not None:
            self._places[self._in_hands] = [RackPlace(t, False, _along(-_AWAY_M))]

    @property
    def slots(self) -> int:
        return self.truth.rows * self.truth.columns

    def T_base_slot(self, number: int) -> RigidTransform:
        """The middle of the opening of slot ``number``, z into it."""
        return RigidTransform.from_matrix(self._slot[number - 1])

    def T_base_part(self, number: int, t: float) -> RigidTransform:
        """The middle of the part's front."""
        return RigidTransform.from_matrix(self._part(number, t))

    def offset(self, part: int, number: int, t: float) -> RigidTransform:
        """``T_slot_part`` of a part's front."""
        return RigidTransform.from_matrix(self._into_slot[number - 1] @ self._part(part, t))

    def in_slot(self, number: int, t: float) -> int | None:
        """The part that rests in slot ``number``."""
        return next((part for part in self._places if self._place(part, t).slot == number), None)

    # -- what a gripper asks

    def nearest(self, t: float, point: Array) -> tuple[int, Array] | None:
        """The part whose grasp point is closest to ``point`` (3,), and that grasp point (3,), in the base."""
        places = [(number, self.grasp_point(number, t)) for number in self._places]
        return min(places, key=lambda place: float(np.linalg.norm(place[1] - point)), default=None)

    def grasp_point(self, number: int, t: float) -> Array:
        """(3,) in the base."""
        T = self._part(number, t)
        point: Array = T[:3, 3] - self.truth.grasp_m * T[:3, 2]
        return point

    def take(self, number: int, t: float) -> None:
        """From ``t`` on the part moves with the flange."""
        self._put(number, RackPlace(t, True, np.linalg.inv(self._flange(t)) @ self._part(number, t)))

    def hand(self, t: float) -> int:
        """From ``t`` on the handed part is in the gripper; returns its number."""
        T = present(self.handed, "handed part").as_matrix()
        self._put(self._in_hands, RackPlace(t, True, T))
        return self._in_hands

    def let_go(self, number: int, t: float) -> None:
        """From ``t`` on the part stays where it is; in a slot it springs back from what it was pressed to."""
        T = self._part(number, t)
        slot = self._slot_at(T)
        if slot is not None:
            T = self._slot[slot - 1] @ relaxed(self._into_slot[slot - 1] @ T, self._shape(slot, t))
        self._put(number, RackPlace(t, False, T, slot))

    # -- contact

    def force(self, t: float) -> tuple[Array, Array]:
        """Force (3,) N on the part that is held, and where it acts (3,) m, in the base; zero without one."""
        held = next((number for number in self._places if self._place(number, t).held), None)
        if held is None:
            return np.zeros(3), np.zeros(3)
        T = self._part(held, t)
        number = self._slot_before(T)
        if number is None:
            return np.zeros(3), np.zeros(3)
        felt = self._touch(held, number, t, T)
        if felt.on_face and not (self.on_face and t - self.on_face[-1] < 1.0):
            self.on_face.append(t)
        force: Array = self._slot[number - 1][:3, :3] @ felt.force
        return force, T[:3, 3]

    def truth_at(self, t: float) -> dict[str, Any]:
        """Where everything is, as plain values."""
        numbers = range(1, self.slots + 1)
        return {
            "slots": [to_pose6(self.T_base_slot(n)).tolist() for n in numbers],
            "parts": [to_pose6(self.T_base_part(part, t)).tolist() for part in self._places],
            "in_slot": {str(n): self.in_slot(n, t) for n in numbers},
            "on_face": list(self.on_face),
        }

    def _touch(self, held: int, number: int, t: float, T_base_part: Array) -> Touch:
        into = self._into_slot[number - 1]
        now = into @ T_base_part
        inward = float(now[2, 3] - (into @ self._part(held, t - _SPAN_S))[2, 3])
        return touch(now, self._shape(number, t), 0.0 if abs(inward) < _STANDS_M else inward)

    def _shape(self, number: int, t: float) -> SlotShape:
        truth, end = self.truth, self.truth.depth_m
        end = min(end, truth.blocked.get(str(number), end))
        if (other := self.in_slot(number, t)) is not None:
            front = (self._into_slot[number - 1] @ self._part(other, t))[2, 3]
            end = min(end, float(front) - truth.part_m[2])
        room = 0.5 * (np.array(truth.opening_m) - np.array(truth.part_m[:2]))
        stiff = truth.stiffness_n_m, truth.side_stiffness_n_m
        return SlotShape(truth.part_m, room, truth.chamfer_m, end, truth.friction, *stiff)

    def _slot_before(self, T_base_part: Array) -> int | None:
        """The slot that a part is nearest to; None where it is not before the plate, or far from it."""
        truth = self.truth
        x, y, depth = (self._into_slot[0] @ T_base_part)[:3, 3]
        if not -truth.part_m[2] < depth < 2.0 * truth.depth_m:
            return None
        at = []
        for place, pitch, count in (
            (x, truth.column_pitch_m, truth.columns),
            (y, truth.row_pitch_m, truth.rows),
        ):
            k = int(np.clip(round(place / pitch), 0, count - 1))
            if abs(place - k * pitch) > max(0.5 * pitch, PLATE_M):
                return None
            at.append(k)
        return 1 + at[1] * truth.columns + at[0]

    def _slot_at(self, T_base_part: Array) -> int | None:
        """The slot that a part at rest there is in."""
        for number, into in enumerate(self._into_slot, 1):
            x, y, depth = (into @ T_base_part)[:3, 3]
            if np.hypot(x, y) < _IN_SLOT_M and 0.0 < depth < self.truth.depth_m + _IN_SLOT_M:
                return number
        return None

    def _in_rack(self, number: int) -> Array:
        row, column = divmod(number - 1, self.truth.columns)
        T = np.eye(4)
        T[:2, 3] = column * self.truth.column_pitch_m, row * self.truth.row_pitch_m
        return T

    def _flange(self, t: float) -> Array:
        """(4, 4), to a microsecond: of two cycles one after the other the pose between them is found once."""
        return self._flange_at(round(t, 6))

    def _part(self, number: int, t: float) -> Array:
        place = self._place(number, t)
        out: Array = self._flange(t) @ place.T if place.held else place.T
        return out

    def _place(self, number: int, t: float) -> RackPlace:
        places = self._places[number]
        return places[max(bisect_right(places, t, key=_since) - 1, 0)]

    def _put(self, number: int, place: RackPlace) -> None:
        self.follow(number, place)
        for listener in tuple(self.listeners):
            listener(number, place)

    # -- to keep a mirror in step

    def places(self) -> dict[int, list[RackPlace]]:
        """Where each part has been so far, oldest first."""
        return {number: list(places) for number, places in self._places.items()}

    def load(self, places: Mapping[int, Sequence[RackPlace]]) -> None:
        """Become a copy of the rack whose :meth:`places` these are."""
        self._places = {number: list(each) for number, each in places.items()}

    def follow(self, number: int, place: RackPlace) -> None:
        """Have a part where it is in the mirrored world."""
        places = self._places[number]
        places[bisect_right(places, place.t, key=_since) :] = [place]


def _since(place: RackPlace) -> float:
    return place.t


def _along(distance_m: float) -> Array:
    T = np.eye(4)
    T[2, 3] = distance_m
    return T
