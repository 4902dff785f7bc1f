"""Which item is next: who can be met in the zone, and who will come."""

from collections.abc import Iterator

import numpy as np

from calibration.belt.pursuit import FixedPoint, Ride
from calibration.belt.tracking import ItemTrack
from cell.poses import Array
from procedures.belt.config import BeltTrackingConfig
from procedures.belt.item_tracking import BeltWatch
from procedures.belt.items import Item
from procedures.belt.motion.gripper_times import GripperTimes
from procedures.belt.motion.tool_joints import ToolJoints
from procedures.belt.motion.tool_path import ToolPath

CHOICES = 3
EDGE_M = 0.002  # inside the zone's first edge, for a belt that slows down
COMING_S = 30.0  # an item that comes later is not waited for above the zone's edge


class ItemSelection:
    """Among the items of ``watch``, for a tool that keeps ``yaw`` (rad) unless it is to turn to them."""

    def __init__(
        self,
        config: BeltTrackingConfig,
        watch: BeltWatch,
        tool: ToolJoints,
        yaw: float,
        descent_s: float,
        gripper_times: GripperTimes,
    ) -> None:
        self._gripper_times = gripper_times
        self._config, self._watch, self._tool, self._wait_yaw = config, watch, tool, yaw
        self._descent_s = descent_s

    def ride(self, item: Item) -> Ride | None:
        """``item`` as it is predicted now."""
        track = self._watch.track(item)
        return None if track is None else Ride(track, self.yaw(item))

    def yaw(self, item: Item) -> float:
        """The turn that brings the tool along the item's longer side, rad: the least one when the item is
        first asked about, and from then on the one next to that, so that noise never turns the tool round."""
        if not self._config.align:
            return self._wait_yaw
        turn = item.yaw - self._tool.heading()
        item.turn += float((turn - item.turn + np.pi / 2) % np.pi - np.pi / 2)
        return item.turn

    def reachable(self, t: float, path: ToolPath, above: Array) -> list[tuple[Item, Ride]]:
        """Who can be met in the zone when the tool goes ``above`` (4,) it now, in the config's order."""
        found: list[tuple[float, Item, Ride]] = []
        for item in self._watch.queue.waiting(self._config.min_sightings):
            if (ride := self.ride(item)) is None:
                continue
            arrival = path.soonest(t, ride, above)
            if not self.has_come_in(ride.track, arrival + self._descent_s):
                break  # and those behind it are still farther upstream
            if self.can_be_met(ride.track, arrival):
                found.append((arrival, item, ride))
                if len(found) == CHOICES and self._config.choice == "leaving first":
                    break
        if self._config.choice == "soonest":
            found.sort(key=lambda one: one[0])
        return [(item, ride) for _, item, ride in found[:CHOICES]]

    def can_be_met(self, track: ItemTrack, arrival: float) -> bool:
        """Whether the item is still in the zone when a contact is over that follows an ``arrival`` above."""
        end = arrival + self._descent_s + max(self._config.dwell_s, self._gripper_times.expected_s)
        return track.along_at(end) <= self._config.zone.max_m

    def has_come_in(self, track: ItemTrack, contact: float) -> bool:
        """Whether a ``contact`` is beyond the zone's first edge, also when the belt slows down before it."""
        return track.along_at(contact) >= self._config.zone.min_m + EDGE_M

    def inside(self, track: ItemTrack, begin: float, end: float) -> bool:
        """Whether the item is between the zone's edges from ``begin`` to ``end``."""
        zone = self._config.zone
        return all(zone.min_m <= track.along_at(t) <= zone.max_m for t in (begin, end))

    def holds(self, point: Array) -> bool:
        """Whether a ``point`` (3,) m is between the zone's edges."""
        zone = self._config.zone
        return zone.min_m <= float(self._watch.tracker.direction @ point) <= zone.max_m

    def coming(self, t: float) -> Iterator[tuple[Item, FixedPoint]]:
        """The next items that are not in the zone yet, and the place above its edge where each will come in.

        That is where the belt carries it to, however fast; a forecast over half a minute would be a guess.
        """
        speed, left_over = self._watch.speed(), CHOICES
        for item in self._watch.queue.waiting(self._config.min_sightings):
            track = self._watch.track(item)
            if track is None or (left := self._config.zone.min_m - track.along_at(t)) <= 0.0:
                continue
            if speed < self._config.standing_m_s or left / speed > COMING_S or not left_over:
                return
            left_over -= 1
            at = np.array([t])
            here = np.array([*track.xy(at)[0], track.z(at)[0]])
            yield item, FixedPoint(np.array([*here + left * track.direction, self.yaw(item)]))
