"""What a live plot of a belt is drawn from: counts as they come beside what is made of them, and the items.

Filled at every decision from what was computed for it anyway.
"""

import numpy as np

from calibration.belt.forecast import TravelForecast
from cell.procedure import Run
from procedures.belt.item_tracking import BeltWatch

BELT, ITEMS = "belt", "items"
COLUMNS = {
    # raw: of the newest count, and from the newest two; the others as the estimator has them at that count
    BELT: ("t_s", "raw_m", "raw_m_s", "travel_m", "speed_m_s"),
    # along and across in the base, as zones are given: now, and where it is expected AHEAD_S later
    ITEMS: ("t_s", "item", "along_m", "across_m", "ahead_m"),
}
AHEAD_S = 0.5
ITEMS_EACH_S = 0.1
MOST_ITEMS = 32  # that come first


class BeltLive:
    """Leaves the traces of one run, and tells its record the same of the belt."""

    def __init__(self, run: Run) -> None:
        self._belt, self._items = (run.trace(name, columns) for name, columns in COLUMNS.items())
        self._newest = self._items_at = -np.inf

    def look(self, watch: BeltWatch, forecast: TravelForecast) -> None:
        """After ``watch`` has learnt; nothing new is counted twice."""
        t = forecast.now
        if t <= self._newest:
            return
        self._newest = t
        stamps, counts = watch.tracker.belt.counts(t)  # the newest, and the one before
        scale, travel = forecast.m_per_count, forecast.travel(t)
        speed = float(counts[-1] - counts[0]) * scale / float(stamps[-1] - stamps[0])
        row = (t, float(counts[-1]) * scale, speed, travel, forecast.speed(t))
        self._belt.add(*row)
        if watch.record is not None:
            watch.record.believes(row)
        if t - self._items_at >= ITEMS_EACH_S:
            self._items_at = t
            ahead = forecast.travels_at(t + AHEAD_S) - travel
            for item in watch.queue.waiting(1)[:MOST_ITEMS]:
                along = watch.along_zone(item)
                self._items.add(t, item.number, along, item.across, along + ahead)
