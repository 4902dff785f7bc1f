"""The items on the belt as they truly are: where each lies at any time, until something takes it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import inf
from typing import Protocol

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from cell.poses import Array
from fakes.world.belt.item_truth import ItemsTruth


class MovingBelt(Protocol):
    """What items lie on. ``T_base_belt``: x with the belt, z up, its origin on the belt's middle line."""

    @property
    def T_base_belt(self) -> RigidTransform: ...
    def travel_at(self, t: float) -> float: ...  # m, of the belt's surface


@dataclass(frozen=True)
class Lying:
    """Item ``number`` (from 0) where it was put: at belt coordinate ``along`` (m, of zero travel).

    ``size_m`` is its length, width and height.
    """

    number: int
    along: float
    across: float
    yaw: float
    size_m: tuple[float, float, float]


class Items:
    """The feed, less what was taken. ``take`` is an event in time, so the past stays as it was."""

    def __init__(self, truth: ItemsTruth, belt: MovingBelt, seed: int) -> None:
        self.truth, self.belt, self._seed = truth, belt, seed
        self.listeners: list[Callable[[int, float], None]] = []
        self._taken: dict[int, float] = {}
        self._lying: dict[int, Lying] = {}
        self._turned: dict[int, Array] = {}
        self._T_base_belt: Array = belt.T_base_belt.as_matrix()

    def lying(self, number: int) -> Lying:
        """How item ``number`` was put on the belt."""
        if number not in self._lying:
            rng = np.random.default_rng([self._seed, number, 0x17E5])
            jitter, lateral, turn = rng.uniform(-1.0, 1.0, 3)
            truth = self.truth
            length, width, height = truth.size_m
            if truth.height_m is not None:
                height = float(rng.uniform(*truth.height_m))
            along = -truth.first_m - number * truth.spacing_m + jitter * truth.jitter_m
            size = length, width, height
            self._lying[number] = Lying(number, along, lateral * truth.lateral_m, turn * truth.yaw_rad, size)
        return self._lying[number]

    def take(self, number: int, t: float) -> None:
        """From ``t`` on the item is not on the belt any more."""
        if number in self._taken:
            return
        self._taken[number] = t
        for listener in tuple(self.listeners):
            listener(number, t)

    def let_go(self, number: int, t: float) -> None:
        """It is not on the belt for that."""

    def taken(self) -> dict[int, float]:
        """When each item was taken that was."""
        return dict(self._taken)

    def load(self, taken: Mapping[int, float]) -> None:
        """Become a copy of the items of which :meth:`taken` this is."""
        self._taken = dict(taken)

    def numbers(self, t: float, low_m: float, high_m: float) -> list[int]:
        """Those between ``low_m`` and ``high_m`` along the belt at ``t``, farthest down the belt first."""
        truth, travel = self.truth, self.belt.travel_at(t)
        high_m = min(high_m, truth.gone_m)
        first = int(np.floor((travel - truth.first_m - truth.jitter_m - high_m) / truth.spacing_m))
        last = int(np.ceil((travel - truth.first_m + truth.jitter_m - low_m) / truth.spacing_m))
        found = []
        for number in range(max(first, 0), last + 1):
            if truth.count and number >= truth.count:
                break
            if t >= self._taken.get(number, inf):
                continue
            if low_m <= self.lying(number).along + travel <= high_m:
                found.append(number)
        return found

    def pose(self, number: int, t: float) -> RigidTransform:
        """``T_base_top`` of an item that lies on the belt: the middle of its upper face, z up."""
        return RigidTransform(self.matrix(number, t), normalize=False, copy=False)

    def matrix(self, number: int, t: float) -> Array:
        """:meth:`pose` as (4, 4): every picture asks for that of every item."""
        if number not in self._turned:  # it does not turn on the belt
            turn = Rotation.from_rotvec([0.0, 0.0, self.lying(number).yaw]).as_matrix()
            T = np.eye(4)
            T[:3, :3] = self._T_base_belt[:3, :3] @ turn
            self._turned[number] = T
        T_base_top = self._turned[number].copy()
        T_base_top[:3, 3] = self.grasp_point(number, t)
        return T_base_top

    def grasp_point(self, number: int, t: float) -> Array:
        """(3,) the middle of its upper face, in the base."""
        lying, T = self.lying(number), self._T_base_belt
        place = [lying.along + self.belt.travel_at(t), lying.across, lying.size_m[2]]
        point: Array = T[:3, :3] @ place + T[:3, 3]
        return point

    def nearest(self, t: float, point: Array) -> tuple[int, Array] | None:
        """The item whose grasp point is closest to ``point`` (3,), and that grasp point (3,), in the base."""
        along = float(self.belt.T_base_belt.inv().apply(point)[0])
        near = self.numbers(t, along - 0.5, along + 0.5)
        if not near:
            return None
        places = np.array([self.grasp_point(number, t) for number in near])
        k = int(np.argmin(np.linalg.norm(places - point, axis=1)))
        return near[k], places[k]
