"""Items on a moving belt: counts and sightings in, positions and the meeting point out."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calibration.belt.arm_time import MotionLimits, rest_to_rest, slower_axis
from calibration.belt.estimator import BeltEstimator
from calibration.belt.forecast import TravelForecast
from calibration.belt.items import (
    NEWEST,
    BeltPlace,
    Levels,
    Scatter,
    Sighting,
    camera_sigma,
    latency_sigma,
    place,
    scatter,
    scattered,
)
from calibration.belt.meeting import Zone, meeting_time
from calibration.belt.slip import Slip
from cell.poses import Array

_GONE = 40  # items whose scatter still tells the camera's noise
_SIGHTINGS = 1000  # that tell the latency


@dataclass(frozen=True)
class RestingArm:
    """The arm rests at ``wait_point`` (x, y in base, m) ``above`` (m) the item and goes down straight."""

    limits: MotionLimits
    wait_point: tuple[float, float]
    above: float

    @property
    def descent_s(self) -> float:
        """t2, seconds."""
        return float(rest_to_rest(np.array(self.above), self.limits))


@dataclass(frozen=True)
class Meeting:
    """First contact at ``t`` (s) and ``xy`` (2,) in base (m)."""

    t: float
    xy: Array


@dataclass(frozen=True)
class ItemTrack:
    """One item as it is known now; ``height`` is its z (m) where it was at ``place.at``.

    ``origins`` (k, 2) is where each sighting puts the item on the belt, along and across (m).
    """

    direction: Array
    forecast: TravelForecast
    place: BeltPlace
    height: float
    sightings: tuple[Sighting, ...]
    origins: Array

    @property
    def flat(self) -> Array:
        """The horizontal part of the belt's direction (2,)."""
        return self.direction[:2]

    @cached_property
    def unit(self) -> Array:
        """The belt's direction seen from above (2,), a unit vector."""
        return np.asarray(self.flat / np.linalg.norm(self.flat))

    @cached_property
    def _origin(self) -> Array:
        """Position (2,) in base at zero travel."""
        u = self.unit
        return np.asarray(self.place.along * u + self.place.across * np.array([-u[1], u[0]]))

    @cached_property
    def _level(self) -> float:
        """Height in base at zero travel."""
        return self.height - float(self.direction[2]) * self.forecast.travel(self.place.at)

    @cached_property
    def _along(self) -> tuple[float, float]:
        """``dot(p, dir)`` at zero travel, and what it gains for each metre of travel."""
        rise = float(self.direction[2])
        return float(self._origin @ self.flat) + rise * self._level, float(self.direction @ self.direction)

    def xy(self, t: Array) -> Array:
        """Position (k, 2) in base (m) at ``t`` (k,), now or later."""
        return np.asarray(self._origin + self.forecast.travels(t)[:, None] * self.flat)

    def was_at(self, t: float) -> Array:
        """Position (2,) in base (m) at ``t``, also before the newest count."""
        now = self.forecast.now
        moved = self.forecast.travel(t) - self.forecast.travel(now)
        return np.asarray(self.xy(np.array([now]))[0] + moved * self.flat)

    def z(self, t: Array) -> Array:
        """Height (k,) in base (m) at ``t`` (k,): a belt may climb."""
        return np.asarray(self._level + self.direction[2] * self.forecast.travels(t))

    def along(self, t: Array) -> Array:
        """``dot(p, dir)`` (k,), where zones are given, m."""
        at_zero, each = self._along
        return np.asarray(at_zero + each * self.forecast.travels(t))

    def along_at(self, t: float) -> float:
        """:meth:`along` at one ``t``."""
        at_zero, each = self._along
        return at_zero + each * self.forecast.travels_at(t)

    def residuals(self) -> Array:
        """Each sighting about the item's place (k, 2), along and across, m."""
        return np.asarray(self.origins - np.array([self.place.along, self.place.across]))

    def cov(self, t: float) -> Array:
        """Covariance (2, 2) of the position at ``t``, m^2."""
        u = self.unit
        across = np.array([-u[1], u[0]])
        travel = self.forecast.sigma(self.place.at, t) * float(np.linalg.norm(self.flat))
        var = self.place.var_along + travel**2
        return np.asarray(var * np.outer(u, u) + self.place.var_across * np.outer(across, across))

    def meet(self, t0: float, arm: RestingArm, zone: Zone, dwell: float) -> Meeting | None:
        """The earliest contact of an arm that leaves its waiting point at ``t0``."""
        t2 = arm.descent_s

        def arm_time(t: Array) -> Array:
            return slower_axis(self.xy(t), np.array(arm.wait_point), arm.limits) + t2

        t = meeting_time(t0, arm_time, self.along, zone, dwell)
        return None if t is None else Meeting(t, self.xy(np.array([t]))[0])


class BeltTracker:
    """Holds what has arrived: counts in :attr:`belt`, sightings by item. Answers depend on nothing else."""

    def __init__(self, belt: BeltEstimator, direction: Array) -> None:
        """``direction`` is the belt's, a unit vector (3,) in base."""
        self.belt = belt
        self.direction = np.asarray(direction, dtype=float)
        self._items: dict[str, deque[tuple[Sighting, float]]] = {}
        self._levels: Levels | None = None
        self._scatter: dict[str, Scatter | None] = {}  # of the items, as far as they were not seen since
        self._gone: deque[Scatter | None] = deque(maxlen=_GONE)
        # The same along the belt, as shares of the variance that the detector stated.
        self._of_stated: dict[str, Scatter | None] = {}
        self._gone_of_stated: deque[Scatter | None] = deque(maxlen=_GONE)
        self._slips: list[Slip] = []
        self._all: deque[Sighting] = deque(maxlen=_SIGHTINGS)

    def see(self, item: str, sighting: Sighting, z: float) -> None:
        """One sighting of ``item`` at height ``z`` (m) has arrived."""
        self._items.setdefault(item, deque(maxlen=NEWEST)).append((sighting, z))
        self._all.append(sighting)
        self._scatter.pop(item, None)
        self._of_stated.pop(item, None)
        self._levels = None

    def slipped(self, slip: Slip) -> None:
        """The belt's wheel has slipped: what was seen before lies elsewhere than the counts say now."""
        self._slips.append(slip)

    @property
    def items(self) -> tuple[str, ...]:
        """Items in the order in which they were first seen."""
        return tuple(self._items)

    def sightings(self, item: str) -> tuple[tuple[Sighting, float], ...]:
        """Sightings of ``item`` with their heights (m), in the order of arrival."""
        return tuple(self._items[item])

    def seen(self, item: str) -> bool:
        """Whether a sighting of ``item`` has arrived."""
        return item in self._items

    def forget(self, item: str) -> None:
        """Answer no more about an item that is gone; what it showed of the noise is kept for a while."""
        if item in self._items:
            self._gone.append(self._scatter_of(item))
            self._gone_of_stated.append(self._of_stated.pop(item, None))
            del self._items[item]
            self._scatter.pop(item, None)
            self._levels = None

    def track(self, item: str, forecast: TravelForecast | None = None) -> ItemTrack | None:
        """The item as known now; None when it has not been seen or nothing has been counted.

        ``forecast`` is the belt's of now where the caller has it already.
        """
        seen = self._items.get(item)
        forecast = forecast or self.belt.forecast()
        if not seen or forecast is None:
            return None
        sightings = [s for s, _ in seen]
        along, across, level = self._in_belt(sightings, [z for _, z in seen], forecast)
        # Where the exposure is known, the belt's speed does not matter.
        speed = np.array([0.0 if s.sure else _speed(forecast, s.t) for s in sightings])
        found = place(along, across, sightings, speed, self.levels(forecast))
        if self._slips:
            doubt = sum(slip.sigma**2 for slip in self._slips if slip.t > found.at)
            found = replace(found, var_along=found.var_along + doubt)
        levels = sorted(level[found.used])  # of an even number the upper one: no tool comes too low for that
        height = float(levels[len(levels) // 2] + self.direction[2] * forecast.travel(found.at))
        return ItemTrack(
            self.direction, forecast, found, height, tuple(sightings), np.stack([along, across], 1)
        )

    def levels(self, forecast: TravelForecast | None = None) -> Levels:
        """The noise of sightings, as those that have arrived show it."""
        if self._levels is None:
            known = [*self._gone, *map(self._scatter_of, self._items)]
            forecast = forecast or self.belt.forecast()
            shares = [*self._gone_of_stated]
            if forecast is not None:
                shares += [self._scatter_of_stated(item, forecast) for item in self._items]
            self._levels = Levels(camera_sigma(known), latency_sigma(self._all), *scattered(shares))
        return self._levels

    def _scatter_of_stated(self, item: str, forecast: TravelForecast) -> Scatter | None:
        if item not in self._of_stated:
            seen = [(s, z) for s, z in self._items[item] if s.sure and s.sigma > 0.0]
            found = None
            if len(seen) > 1:
                sightings = [s for s, _ in seen]
                along, _, _ = self._in_belt(sightings, [z for _, z in seen], forecast)
                found = scatter(along)
                stated = float(np.mean([s.sigma**2 for s in sightings]))
                found = found and Scatter(found.variance / stated, found.degrees)
            self._of_stated[item] = found
        return self._of_stated[item]

    def _scatter_of(self, item: str) -> Scatter | None:
        if item not in self._scatter:
            xy = np.array([s.xy for s, _ in self._items[item]])
            self._scatter[item] = scatter(xy @ self._across())
        return self._scatter[item]

    def _across(self) -> Array:
        u = self.direction[:2] / np.linalg.norm(self.direction[:2])
        return np.array([-u[1], u[0]])

    def _in_belt(
        self, sightings: Sequence[Sighting], z: Sequence[float], forecast: TravelForecast
    ) -> tuple[Array, Array, Array]:
        """Positions along, across and up (k,) with the travel of the belt taken off."""
        xy = np.array([s.xy for s in sightings])
        travel = forecast.travelled(np.array([s.t for s in sightings]))
        across = self._across()
        flat = float(np.linalg.norm(self.direction[:2]))
        for slip in self._slips:
            travel = travel - slip.by / flat * np.array([s.t < slip.t for s in sightings])
        along = xy @ np.array([across[1], -across[0]]) - travel * flat
        return along, xy @ across, np.array(z) - travel * self.direction[2]


def _speed(forecast: TravelForecast, t: float) -> float:
    """Speed about ``t`` in the past, m/s."""
    return (forecast.travel(t + 0.01) - forecast.travel(t - 0.01)) / 0.02
