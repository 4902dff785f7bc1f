"""Where and when a tool that does not follow meets an item: by our forecast, or by the classic method."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from calibration.belt.arm_time import MotionLimits
from calibration.belt.classic import ClassicTarget, ClassicTimes, classic_target, recomputed
from calibration.belt.meeting import Zone
from calibration.belt.tracking import ItemTrack, RestingArm
from cell.poses import Array
from procedures.belt.config import BeltTrackingConfig
from procedures.belt.item_tracking import BeltWatch
from procedures.belt.items import Item

_LAST_S = 0.03  # before contact the aim is kept


@dataclass
class Aim:
    """A contact that was agreed on: when, and where as it is believed now. ``height`` of the item, m."""

    contact: float
    xy: Array
    height: float


class Strategy(Protocol):
    """Chooses a contact for an arm that leaves its waiting point at ``t``, and aims better on the way."""

    def meet(self, item: Item, t: float) -> Aim | None: ...
    def improve(self, item: Item, aim: Aim, t: float) -> None: ...
    def later(self, item: Item, aim: Aim, by_s: float) -> Aim | None:
        """The same item by so much later; None for a method that cannot."""
        ...


def strategy(config: BeltTrackingConfig, watch: BeltWatch, wait: Array, descent_s: float) -> Strategy:
    """What ``config.method`` names. ``wait`` (3,) is the waiting point, m; ``descent_s`` t2."""
    limits = config.limits
    axis = MotionLimits(limits.speed_m_s, limits.accel_m_s2, limits.jerk_m_s3)
    arm = RestingArm(axis, (float(wait[0]), float(wait[1])), config.down_m)
    if config.method == "classic":
        return ClassicMethod(config, watch, arm, ClassicTimes(config.T1_s, descent_s))
    return Predicted(config, watch, arm)


class Predicted:
    """The earliest contact in the zone, aimed anew at every decision."""

    def __init__(self, config: BeltTrackingConfig, watch: BeltWatch, arm: RestingArm) -> None:
        self._config, self._watch, self._arm = config, watch, arm
        self._zone = Zone(config.zone.min_m, config.zone.max_m)

    def meet(self, item: Item, t: float) -> Aim | None:
        if (track := self._watch.track(item)) is None:
            return None
        met = track.meet(t, self._arm, self._zone, self._config.dwell_s)
        return None if met is None else _aim(track, met.t)

    def improve(self, item: Item, aim: Aim, t: float) -> None:
        if t < aim.contact - _LAST_S and (track := self._watch.track(item)) is not None:
            better = _aim(track, aim.contact)
            aim.xy, aim.height = better.xy, better.height

    def later(self, item: Item, aim: Aim, by_s: float) -> Aim | None:
        track = self._watch.track(item)
        if track is None:
            return None
        at = aim.contact + by_s
        ends = track.along(np.array([at, at + self._config.dwell_s]))
        return _aim(track, at) if self._zone.holds(ends).all() else None


def _aim(track: ItemTrack, contact: float) -> Aim:
    at = np.array([contact])
    return Aim(contact, track.xy(at)[0], float(track.z(at)[0]))


class ClassicMethod:
    """The classic method: speed from two counts, a fixed T1 whatever the way, the target anew every 100 ms.

    Heights are ours: that method takes the belt to be level, and one false height would drive the tool into
    an item.
    """

    def __init__(
        self, config: BeltTrackingConfig, watch: BeltWatch, arm: RestingArm, times: ClassicTimes
    ) -> None:
        self._config, self._watch, self._arm, self._times = config, watch, arm, times
        self._zone = Zone(config.zone.min_m, config.zone.max_m)
        self._first: float | None = None
        self._last = -np.inf

    def meet(self, item: Item, t: float) -> Aim | None:
        self._since(t)
        if (target := self._target(item)) is None:
            return None
        met = target.meet(self._arm, self._times, self._zone, self._config.dwell_s)
        if met is None or (track := self._watch.track(item)) is None:
            return None
        return Aim(met[0], met[1], _aim(track, met[0]).height)

    def improve(self, item: Item, aim: Aim, t: float) -> None:
        turn = recomputed(self._since(t), t)
        if turn > self._last and t < aim.contact - self._times.t2_s:
            self._last = turn
            target, track = self._target(item), self._watch.track(item)
            if target is not None and track is not None:
                aim.xy = target.at(np.array([aim.contact]))[0]
                aim.height = _aim(track, aim.contact).height

    def later(self, item: Item, aim: Aim, by_s: float) -> Aim | None:
        del item, aim, by_s
        return None

    def _since(self, t: float) -> float:
        """From when on the target is computed anew every 100 ms."""
        self._first = t if self._first is None else self._first
        return self._first

    def _target(self, item: Item) -> ClassicTarget | None:
        tracker = self._watch.tracker
        if not tracker.seen(item.key):
            return None
        sighting, z = tracker.sightings(item.key)[-1]
        t, n = tracker.belt.counts(sighting.t)
        xyz = np.array([*sighting.xy, z])
        scale = tracker.belt.encoder.m_per_count
        return classic_target(t, n, sighting.t, xyz, tracker.direction, scale)
