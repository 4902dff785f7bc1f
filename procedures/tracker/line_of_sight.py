"""What a tracker sees of a reflector on an arm: range, elevation, the reflector's cone, and a free beam."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from cell.guard.geometry import segment_box_distance, segment_segment_distance
from cell.poses import Array
from procedures.tracker.config import Reflector, SightLimits

_NEST_M = 0.1  # what the beam meets so close to the reflector is its own nest and flange
REASONS = ("too near or too far", "too high or too low", "the reflector looks away", "the beam is blocked")


@dataclass(frozen=True, eq=False)
class LineOfSight:
    """The tracker at ``place`` (``T_base_tracker``), and what could stand in its beam.

    ``capsules`` are the radii (k,) of the links that :meth:`hidden` is given; ``boxes`` are lower and upper
    corners of keep-out boxes in the base.
    """

    place: RigidTransform
    sight: SightLimits
    reflectors: Sequence[Reflector]
    radii: Array
    boxes: Sequence[tuple[Array, Array]] = ()

    def faults(self, T: Array, p: Array, target: NDArray[np.int64]) -> NDArray[np.int64]:
        """(n,): why a reflector is not seen, by its place in ``REASONS``, -1 where it is.

        ``T`` (n, 4, 4) are flange poses and ``p`` (n, 3) the reflectors ``target`` (n,) in the base. The free
        beam is :meth:`hidden`'s.
        """
        at = self.place.inv().apply(p)
        distance = np.linalg.norm(at, axis=1)
        elevation = np.arcsin(np.clip(at[:, 2] / np.maximum(distance, 1e-9), -1.0, 1.0))
        out = np.full(len(p), -1, dtype=np.int64)
        beam = (self.place.translation - p) / np.maximum(distance, 1e-9)[:, None]
        for k, reflector in enumerate(self.reflectors):
            if reflector.normal is None:
                continue
            normal = np.array(reflector.normal) / np.linalg.norm(reflector.normal)
            mine = target == k
            off = np.arccos(np.clip(np.sum(beam[mine] * (T[mine, :3, :3] @ normal), axis=1), -1.0, 1.0))
            out[np.flatnonzero(mine)[off > reflector.half_angle_rad]] = 2
        low, high = self.sight.elevation_rad
        out[(elevation < low) | (elevation > high)] = 1
        low, high = self.sight.range_m
        out[(distance < low) | (distance > high)] = 0
        return out

    def hidden(self, p: Array, ends: Array | None) -> NDArray[np.bool_]:
        """(n,): whether a link (``ends`` (n, k, 2, 3), base) or a box comes into the beam to ``p`` (n, 3)."""
        n, tracker = len(p), self.place.translation
        away = tracker - p
        length = np.linalg.norm(away, axis=1, keepdims=True)
        start = p + away * np.minimum(_NEST_M / np.maximum(length, 1e-9), 1.0)
        stop = np.broadcast_to(tracker, start.shape)
        out = np.zeros(n, dtype=bool)
        for low, high in self.boxes:
            out |= segment_box_distance(start, stop, low, high) < self.sight.clearance_m
        if ends is not None:
            k = ends.shape[1]
            links = ends.reshape(-1, 2, 3)
            gap = segment_segment_distance(
                np.repeat(start, k, axis=0), np.repeat(stop, k, axis=0), links[:, 0], links[:, 1]
            )
            out |= np.any(gap.reshape(n, k) < self.radii + self.sight.clearance_m, axis=1)
        return out

    def sigma(self, p: Array, noise: Mapping[str, Any]) -> Array:
        """(n,) m: standard deviation of a reading along one axis, of reflectors at ``p`` (n, 3), base."""
        distance = np.linalg.norm(p - self.place.translation, axis=1)
        out: Array = noise["sigma0"] + noise["sigma_per_m"] * distance
        return out
