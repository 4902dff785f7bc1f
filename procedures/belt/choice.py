"""Which item is next: who can be met in the zone, and who will come."""

import numpy as np

from calibration.belt.pursuit import Place, Ride
from calibration.belt.tracking import Track
from cell.poses import Array
from procedures.belt.config import BeltTrackingConfig
from procedures.belt.items import Item
from procedures.belt.joints import ToolJoints
from procedures.belt.watch import BeltWatch
from procedures.belt.way import Way

CHOICES = 3
COMING_S = 30.0  # an item that comes later is not waited for above the zone's edge


class Choice:
    """Among the items of ``watch``, for a tool that keeps ``yaw`` (rad) unless it is to turn to them."""

    def __init__(
        self, config: BeltTrackingConfig, watch: BeltWatch, tool: ToolJoints, yaw: float, descent_s: float
    ) -> None:
        self._config, self._watch, self._tool, self._wait_yaw = config, watch, tool, yaw
        self._descent_s = descent_s

    def ride(self, item: Item) -> Ride | None:
        """``item`` as it is foretold now."""
        track = self._watch.track(item)
        return None if track is None else Ride(track, self.yaw(item))

    def yaw(self, item: Item) -> float:
        """The least turn that brings the tool along the item's longer side or across it, rad."""
        if not self._config.align:
            return self._wait_yaw
        turn = item.yaw - self._tool.heading()
        return float((turn + np.pi / 2) % np.pi - np.pi / 2)

    def reachable(self, t: float, way: Way, above: Array) -> list[tuple[Item, Ride]]:
        """Who can be met in the zone when the tool goes ``above`` (4,) it now, in the config's order."""
        found: list[tuple[float, Item, Ride]] = []
        for item in self._watch.queue.waiting(self._config.min_sightings):
            if (ride := self.ride(item)) is None:
                continue
            arrival = way.soonest(t, ride, above)
            if float(ride.track.along(np.array([arrival + self._descent_s]))[0]) < self._config.zone.min_m:
                break  # and those behind it are still farther upstream
            if self.can_be_met(ride.track, arrival):
                found.append((arrival, item, ride))
                if len(found) == CHOICES and self._config.choice == "leaving first":
                    break
        if self._config.choice == "soonest":
            found.sort(key=lambda one: one[0])
        return [(item, ride) for _, item, ride in found[:CHOICES]]

    def can_be_met(self, track: Track, arrival: float) -> bool:
        """Whether the item is still in the zone when a contact is over that follows an ``arrival`` above."""
        end = arrival + self._descent_s + self._config.dwell_s + self._config.grip_timeout_s / 3.0
        return bool(float(track.along(np.array([end]))[0]) <= self._config.zone.max_m)

    def is_past(self, track: Track, contact: float) -> bool:
        """Whether the item has left the zone when the dwell after ``contact`` is over."""
        return bool(
            float(track.along(np.array([contact + self._config.dwell_s]))[0]) > self._config.zone.max_m
        )

    def coming(self, t: float) -> tuple[Item, Place] | None:
        """The first item that is not in the zone yet, and the place above its edge where it will come in.

        That is where the belt carries it to, however fast; a forecast over half a minute would be a guess.
        """
        now, speed = np.array([t]), self._watch.speed()
        for item in self._watch.queue.waiting(self._config.min_sightings):
            track = self._watch.track(item)
            if track is None or (left := self._config.zone.min_m - float(track.along(now)[0])) <= 0.0:
                continue
            if speed < self._config.standing_m_s or left / speed > COMING_S:
                return None
            here = np.array([*track.xy(now)[0], track.z(now)[0]])
            return item, Place(np.array([*here + left * track.direction, self.yaw(item)]))
        return None
