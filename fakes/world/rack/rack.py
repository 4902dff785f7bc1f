"""The rack as it truly is: where its slots and parts are at any time, and what a held part feels."""

from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from cell.poses import Array, from_pose6, to_pose6
from fakes.world.rack.contact import SlotShape, Touch, touch
from fakes.world.rack.truth import RackTruth

_SPAN_S = 0.002  # over which it is seen whether a part goes in or out
_STANDS_M = 1e-7
_IN_SLOT_M = 0.005  # across: a part nearer than this to a slot's axis is in it


@dataclass(frozen=True)
class _Place:
    """From ``t`` on a part is ``T`` in the base, or in the flange while it is ``held``."""

    t: float
    held: bool
    T: RigidTransform


class Rack:
    """``flange(t)`` is the true ``T_base_flange``. Parts are numbered from 0, slots from 1."""

    def __init__(self, truth: RackTruth, flange: Callable[[float], RigidTransform], t: float) -> None:
        self.truth, self._flange = truth, flange
        self.T_base_rack = from_pose6(truth.T_base_rack)
        self.on_face: list[float] = []  # when a part's front met the plate
        self._places: dict[int, list[_Place]] = {}
        for number, part in enumerate(truth.parts):
            if part.slot is not None:
                T = self.T_base_slot(part.slot) * RigidTransform.from_translation([0.0, 0.0, truth.depth_m])
            else:
                T = from_pose6(part.T_base_part or [])
            self._places[number] = [_Place(t, False, T)]

    @property
    def slots(self) -> int:
        return self.truth.rows * self.truth.columns

    def T_base_slot(self, number: int) -> RigidTransform:
        """The middle of the opening of slot ``number``, z into it."""
        row, column = divmod(number - 1, self.truth.columns)
        at = [column * self.truth.column_pitch_m, row * self.truth.row_pitch_m, 0.0]
        return self.T_base_rack * RigidTransform.from_translation(at)

    def T_base_part(self, number: int, t: float) -> RigidTransform:
        """The middle of the part's front."""
        place = self._place(number, t)
        return self._flange(t) * place.T if place.held else place.T

    def in_slot(self, number: int, t: float) -> int | None:
        """The part that rests in slot ``number``."""
        T_slot = self.T_base_slot(number).inv()
        for part in self._places:
            if self._place(part, t).held:
                continue
            x, y, depth = (T_slot * self.T_base_part(part, t)).translation
            if np.hypot(x, y) < _IN_SLOT_M and 0.0 < depth < self.truth.depth_m + _IN_SLOT_M:
                return part
        return None

    # -- what a gripper asks

    def nearest(self, t: float, point: Array) -> tuple[int, Array] | None:
        """The part whose grasp point is closest to ``point`` (3,), and that grasp point (3,), in the base."""
        places = [(number, self.grasp_point(number, t)) for number in self._places]
        return min(places, key=lambda place: float(np.linalg.norm(place[1] - point)), default=None)

    def grasp_point(self, number: int, t: float) -> Array:
        """(3,) in the base."""
        point: Array = self.T_base_part(number, t).apply([0.0, 0.0, -self.truth.grasp_m])
        return point

    def take(self, number: int, t: float) -> None:
        """From ``t`` on the part moves with the flange."""
        self._put(number, _Place(t, True, self._flange(t).inv() * self.T_base_part(number, t)))

    def let_go(self, number: int, t: float) -> None:
        """From ``t`` on the part stays where it is."""
        self._put(number, _Place(t, False, self.T_base_part(number, t)))

    # -- contact

    def force(self, t: float) -> tuple[Array, Array]:
        """Force (3,) N on the part that is held, and where it acts (3,) m, in the base; zero without one."""
        held = next((number for number in self._places if self._place(number, t).held), None)
        if held is None:
            return np.zeros(3), np.zeros(3)
        T = self.T_base_part(held, t)
        number = self._slot_before(T)
        felt = self._touch(held, number, t, T)
        if felt.on_face and not (self.on_face and t - self.on_face[-1] < 1.0):
            self.on_face.append(t)
        force: Array = self.T_base_slot(number).rotation.apply(felt.force)
        return force, T.translation

    def offset(self, part: int, number: int, t: float) -> RigidTransform:
        """``T_slot_part`` of a part's front."""
        return self.T_base_slot(number).inv() * self.T_base_part(part, t)

    def truth_at(self, t: float) -> dict[str, Any]:
        """Where everything is, as plain values."""
        return {
            "T_base_rack": to_pose6(self.T_base_rack).tolist(),
            "parts": [to_pose6(self.T_base_part(number, t)).tolist() for number in self._places],
            "in_slot": {str(n): self.in_slot(n, t) for n in range(1, self.slots + 1)},
            "on_face": list(self.on_face),
        }

    def _touch(self, held: int, number: int, t: float, T_base_part: RigidTransform) -> Touch:
        T_slot = self.T_base_slot(number).inv()
        now = T_slot * T_base_part
        if now.translation[2] < -self.truth.part_m[2]:
            return Touch(np.zeros(3))
        before = T_slot * self.T_base_part(held, t - _SPAN_S)
        inward = float(now.translation[2] - before.translation[2])
        return touch(now, self._shape(number, t), 0.0 if abs(inward) < _STANDS_M else inward)

    def _shape(self, number: int, t: float) -> SlotShape:
        truth, end = self.truth, self.truth.depth_m
        end = min(end, truth.blocked.get(str(number), end))
        if (other := self.in_slot(number, t)) is not None:
            end = min(end, float(self.offset(other, number, t).translation[2]) - truth.part_m[2])
        room = 0.5 * (np.array(truth.opening_m) - np.array(truth.part_m[:2]))
        stiff = truth.stiffness_n_m, truth.side_stiffness_n_m
        return SlotShape(truth.part_m, room, truth.chamfer_m, end, truth.friction, *stiff)

    def _slot_before(self, T_base_part: RigidTransform) -> int:
        x, y, _ = (self.T_base_rack.inv() * T_base_part).translation
        truth = self.truth
        column = int(np.clip(round(x / truth.column_pitch_m), 0, truth.columns - 1))
        row = int(np.clip(round(y / truth.row_pitch_m), 0, truth.rows - 1))
        return 1 + row * truth.columns + column

    def _place(self, number: int, t: float) -> _Place:
        places = self._places[number]
        return places[max(bisect_right(places, t, key=lambda place: place.t) - 1, 0)]

    def _put(self, number: int, place: _Place) -> None:
        places = self._places[number]
        places[bisect_right(places, place.t, key=lambda known: known.t) :] = [place]
