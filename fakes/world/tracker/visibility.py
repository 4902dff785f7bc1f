"""What a tracker could see at a time: what stands in the beam, what faces away, what is too far."""

from collections.abc import Callable
from dataclasses import dataclass
from math import inf

import numpy as np

from cell.poses import Array
from fakes.world.arm.distance import to_segments
from fakes.world.tracker.stand import Stand
from fakes.world.tracker.truth import BoxTruth, ReflectorTruth, TrackerTruth

BROKEN, TURNED_AWAY, OUT_OF_RANGE = "beam broken", "reflector turned away", "out of the field of view"

Carrier = Callable[[str, float], Array]  # what a reflector is on, at a time, in the base (4, 4)
Links = Callable[[float], Array]  # both ends of the axis of each of an arm's links, (m, 2, 3) m, in the base
Still = Callable[[str, float], bool]  # whether that does not move from a time on, as far as is planned


@dataclass
class _Hindrance:
    """Something that keeps the light from one reflector, or from all, for a time."""

    why: str
    since: float
    until: float
    reflector: str | None


class ReflectorVisibility:
    """Whether light comes back from a reflector, as a function of time."""

    def __init__(
        self,
        truth: TrackerTruth,
        reflectors: dict[str, ReflectorTruth],
        carrier: Carrier,
        still: Still,
        stand: Stand,
        links: Links | None = None,
        links_on: str = "arm",
    ) -> None:
        self._truth, self._reflectors, self._stand = truth, reflectors, stand
        self._carrier, self._still, self._links, self._links_on = carrier, still, links, links_on
        self._hindrances: list[_Hindrance] = []
        self._known: dict[str, tuple[float, Array, Array | None]] = {}
        self._judged: dict[str, tuple[float, str]] = {}
        self._widest = {name: np.cos(reflector.half_angle_rad) for name, reflector in reflectors.items()}

    def hinder(self, why: str, t: float, reflector: str | None = None) -> None:
        """From ``t`` on no light comes back from ``reflector``, or from any."""
        self._hindrances.append(_Hindrance(why, t, inf, reflector))

    def free(self, t: float, why: str | None = None) -> None:
        """What hinders because of ``why``, or at all, ends at ``t``."""
        for hindrance in self._hindrances:
            if why in (None, hindrance.why):
                hindrance.until = min(hindrance.until, t)

    def hindered_between(self, since: float, t: float) -> list[float]:
        """When hindrances began in ``since <= when <= t``."""
        return sorted(h.since for h in self._hindrances if since <= h.since <= t)

    def position(self, name: str, t: float) -> Array:
        """The reflector's true centre (3,) in the base, m."""
        out: Array = self._where(name, t)[0]
        return out

    def local(self, name: str, t: float) -> Array:
        """The reflector's true centre (3,) in the tracker frame, m."""
        where, how = self._stand.frame(t)
        out: Array = how.T @ (self.position(name, t) - where)
        return out

    def hindrance(self, name: str, t: float) -> str:
        """Why no light comes back from the reflector at ``t``; empty when it does."""
        for hindrance in self._hindrances:
            if hindrance.reflector in (None, name) and hindrance.since <= t < hindrance.until:
                return hindrance.why
        judged = self._judged.get(name)
        if judged is None or not self._rests(name, judged[0], t):
            judged = self._judged[name] = t, self._in_the_way(name, t)
        return judged[1]

    def _rests(self, name: str, since: float, t: float) -> bool:
        """Whether reflector, arm and tracker are at ``t`` where they were ``since``."""
        return (
            since <= t
            and self._stand.rests(since, t)
            and self._still(self._reflectors[name].on, since)
            and (self._links is None or self._still(self._links_on, since))
        )

    def _in_the_way(self, name: str, t: float) -> str:
        """What :meth:`hindrance` is by where everything is."""
        where, how = self._stand.frame(t)
        centre, normal = self._where(name, t)
        way = centre - where
        distance = float(np.linalg.norm(way))
        height = float(how[:, 2] @ way)
        nearest, farthest = self._truth.range_m
        lowest, highest = self._truth.elevation_rad
        if not (nearest <= distance <= farthest and lowest <= np.arcsin(height / distance) <= highest):
            return OUT_OF_RANGE
        if normal is not None and -normal @ way < self._widest[name] * distance:
            return TURNED_AWAY
        if self._truth.arm_radius_m and self._behind_arm(where, way, distance, t):
            return BROKEN
        if any(_passes(box, where, way) for box in self._truth.opaque):
            return BROKEN
        return ""

    def _where(self, name: str, t: float) -> tuple[Array, Array | None]:
        """Centre and unit normal in the base; not worked out again while its carrier stands still."""
        reflector, known = self._reflectors[name], self._known.get(name)
        if known is not None and (t == known[0] or (t > known[0] and self._still(reflector.on, known[0]))):
            return known[1], known[2]
        carrier, normal = self._carrier(reflector.on, t), None
        if reflector.normal is not None:
            normal = carrier[:3, :3] @ reflector.normal / np.linalg.norm(reflector.normal)
        centre: Array = carrier[:3, :3] @ reflector.point + carrier[:3, 3]
        self._known[name] = (t, centre, normal)
        return centre, normal

    def _behind_arm(self, start: Array, way: Array, distance: float, t: float) -> bool:
        if self._links is None:
            return False
        middle, along, half = (start + 0.5 * way)[None], (way / distance)[None], np.array([0.5 * distance])
        gaps = to_segments(self._links(t)[None], middle, along, half)
        return bool(gaps.min() < self._truth.arm_radius_m)


def _passes(box: BoxTruth, start: Array, way: Array) -> bool:
    """Whether the line from ``start`` along ``way`` passes the box: the slabs of its three axes overlap."""
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = (np.array(box.min) - start) / way, (np.array(box.max) - start) / way
    # A line along a slab is nan where it touches the slab's face: there it is inside.
    enters = np.nan_to_num(np.minimum(a, b), nan=-inf, neginf=-inf, posinf=inf).max()
    leaves = np.nan_to_num(np.maximum(a, b), nan=inf, neginf=-inf, posinf=inf).min()
    return bool(max(enters, 0.0) <= min(leaves, 1.0))
