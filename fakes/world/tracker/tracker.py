"""A laser tracker as a thing: what it aims at, what it follows and what it reads, whatever the wire is.

Every face shares it. Time only goes on: what it is told, it is told at a time that is not before any that it
was asked about.
"""

from dataclasses import dataclass
from math import atan2, ceil, floor, hypot, tau

import numpy as np

from cell.poses import Array, to_pose6
from fakes.world.tracker.stand import Stand
from fakes.world.tracker.truth import ReflectorTruth, TrackerTruth
from fakes.world.tracker.visibility import Carrier, Links, ReflectorVisibility, Still

NOT_AIMED, MULTIPLE, NO_TARGET = "no reflector aimed at", "several reflectors", "no reflector found"
_LOOK_S = 0.05  # so often it sees whether the light of a moving reflector still comes back
_STREAM = 0x7C


@dataclass(frozen=True, slots=True)
class Reading:
    """What the instrument shows; ``point`` (3,) m is in the tracker frame, None without a distance."""

    t: float
    hz: float  # rad, clockwise from N seen from above
    v: float  # rad from the zenith
    point: Array | None
    status: str  # why there is no distance
    doubtful: bool  # the instrument does not vouch for the point

    @property
    def slope(self) -> float:
        """Distance, m; 0 without one."""
        return 0.0 if self.point is None else float(np.linalg.norm(self.point))


class Tracker:
    """The instrument; ``t0`` is the twin's start.

    Noise is a function of seed and time: the same reading taken twice is the same.
    """

    def __init__(
        self,
        truth: TrackerTruth,
        reflectors: dict[str, ReflectorTruth],
        carrier: Carrier,
        still: Still,
        seed: int,
        t0: float,
        links: Links | None = None,
        links_on: str = "arm",
    ) -> None:
        self.truth, self.reflectors = truth, reflectors
        self.stand = Stand(truth, t0)
        self.visibility = ReflectorVisibility(truth, reflectors, carrier, still, self.stand, links, links_on)
        self.constant_m = truth.constant_m
        self.doubtful = False
        self.shake: tuple[float, float] = (0.0, 0.0)  # amplitude (m) and frequency (Hz)
        self.target: str | None = None
        self.status = NOT_AIMED
        self._still, self._seed, self._t0 = still, seed, t0
        self.follows = False
        self._aim = (0.0, np.pi / 2)
        self.seen = t0  # until then it is known what happened to the target

    # -- what it reads

    def read(self, t: float) -> Reading:
        """The reading at ``t``."""
        self.advance(t)
        if self.target is None:
            return Reading(t, *self._aim, None, self.status, self.doubtful)
        true = self.visibility.local(self.target, t)
        distance = float(np.linalg.norm(true))
        error = self.constant_m - self.reflectors[self.target].constant_m
        point = true * (1.0 + error / distance) + self._noise(t, distance)
        hz, v = polar(point)
        return Reading(t, hz, v, point, "", self.doubtful)

    def last_tick(self, t: float) -> float:
        """When the newest of its regular readings before ``t`` was taken."""
        return self._t0 + floor((t - self._t0) * self.truth.rate_hz + 1e-6) / self.truth.rate_hz

    def advance(self, t: float) -> None:
        """See what became of the target by ``t``."""
        if t <= self.seen:
            return
        since, self.seen = self.seen, t
        if self.target is None:
            return
        for when in self._looks(self.target, since, t):
            if status := self._lost(self.target, when):
                self._aim = polar(self.visibility.local(self.target, when)) if self.follows else self._aim
                self.target, self.status = None, status
                return

    # -- what it does

    def turn_to(self, t: float, hz: float, v: float) -> None:
        """Aim there; what it followed is let go."""
        self.release(t)
        self._aim = (hz % (2 * np.pi), v)

    def release(self, t: float) -> None:
        """Follow and measure nothing any more; the aim stays."""
        aim = self.aim(t)
        self.target, self.status, self._aim = None, NOT_AIMED, aim

    def restart(self, t: float) -> None:
        """It has been switched off and on: it follows nothing and has the constant it had at first."""
        self.turn_to(t, 0.0, np.pi / 2)
        self.follows, self.constant_m = False, self.truth.constant_m

    def follow(self, t: float, on: bool) -> None:
        """Follow what it aims at when that moves, or stay."""
        self._aim, self.follows = self.aim(t), on

    def search(self, t: float, half_hz: float, half_v: float) -> str:
        """Look for reflectors about the aim and aim at the nearest; empty, or why that fails.

        After a failure it aims at nothing, where it did.
        """
        hz, v = self.aim(t)
        self.release(t)
        centre, found = direction(hz, v), []
        for name in self.reflectors:
            if self.visibility.hindrance(name, t):
                continue
            there = self.visibility.local(name, t)
            its_hz, its_v = polar(there)
            if abs(_wrap(its_hz - hz)) <= half_hz and abs(its_v - v) <= half_v:
                found.append((_angle(centre, there), name, there))
        if not found:
            self.status = NO_TARGET
            return NO_TARGET
        _, name, nearest = min(found, key=lambda entry: entry[0])
        if any(
            other != name and _angle(nearest, there) < self.truth.separable_rad for _, other, there in found
        ):
            self.status = MULTIPLE
            return MULTIPLE
        self.target, self.status, self._aim = name, "", polar(nearest)
        return ""

    def lock(self, t: float, reflector: str) -> str:
        """What somebody does by hand: aim at ``reflector`` and follow it; empty, or why that fails."""
        self.turn_to(t, *polar(self.visibility.local(reflector, t)))
        self.follow(t, True)
        return self.search(t, self.truth.search_rad, self.truth.search_rad)

    def aim(self, t: float) -> tuple[float, float]:
        """Hz and V to which it points, rad."""
        self.advance(t)
        if self.target is not None and self.follows:
            return polar(self.visibility.local(self.target, t))
        return self._aim

    def turning_s(self, t: float, hz: float, v: float) -> float:
        """How long it takes to turn there."""
        now = self.aim(t)
        return max(abs(_wrap(hz - now[0])), abs(v - now[1])) / self.truth.turn_rad_s

    # -- what is true

    def told(self, t: float) -> dict[str, object]:
        """The truth about it at ``t`` (inf: the last known time), as plain JSON values."""
        t = t if np.isfinite(t) else self.seen
        return {
            "serial": self.truth.serial,
            "T_base_tracker": to_pose6(self.stand.at(t)).tolist(),
            "sigma0_m": self.truth.sigma0_m,
            "sigma_per_m": self.truth.sigma_per_m,
            "constant_m": self.constant_m,
            "target": self.target,
            "reflectors": {
                name: {
                    **reflector.model_dump(),
                    "p_base": self.visibility.position(name, t).tolist(),
                    "hindrance": self.visibility.hindrance(name, t),
                }
                for name, reflector in self.reflectors.items()
            },
        }

    # -- how it comes about

    def _looks(self, target: str, since: float, t: float) -> list[float]:
        """The times at which the target is looked at: on a grid, so that asking often changes nothing."""
        looks = [*self.visibility.hindered_between(since, t), t]
        if self._still(self.reflectors[target].on, since):
            return looks
        first, last = floor((since - self._t0) / _LOOK_S) + 1, ceil((t - self._t0) / _LOOK_S) - 1
        return sorted([*looks, *(self._t0 + k * _LOOK_S for k in range(first, last + 1))])

    def _lost(self, name: str, t: float) -> str:
        hindrance = self.visibility.hindrance(name, t)
        if hindrance or self.follows:
            return hindrance
        off = _angle(direction(*self._aim), self.visibility.local(name, t))
        return NOT_AIMED if off > self.truth.aim_rad else ""

    def _noise(self, t: float, distance: float) -> Array:
        sigma = self.truth.sigma0_m + self.truth.sigma_per_m * distance
        rng = np.random.default_rng([self._seed, _STREAM, round((t - self._t0) * 1e6)])
        amplitude, frequency = self.shake
        shaken = amplitude * np.sin(2 * np.pi * frequency * (t - self._t0)) * np.array([0.6, 0.0, 0.8])
        out: Array = sigma * rng.standard_normal(3) + shaken
        return out


def polar(point: Array) -> tuple[float, float]:
    """Hz and V (rad) of a point (3,) in the tracker frame."""
    x, y, z = point.tolist()
    return atan2(x, y) % tau, atan2(hypot(x, y), z)


def direction(hz: float, v: float) -> Array:
    """The unit vector (3,) in the tracker frame."""
    return np.array([np.sin(hz) * np.sin(v), np.cos(hz) * np.sin(v), np.cos(v)])


def _angle(a: Array, b: Array) -> float:
    return float(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))


def _wrap(angle: float) -> float:
    return float((angle + np.pi) % (2 * np.pi) - np.pi)
