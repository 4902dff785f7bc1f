"""What encoder and camera say, turned into items on the belt."""

from collections import deque
from collections.abc import Callable, Mapping
from typing import Any, Self

import numpy as np

from calibration.belt.estimator import BeltEstimator
from calibration.belt.estimator import Encoder as Scale
from calibration.belt.forecast import Forecast
from calibration.belt.tracking import BeltTracker, Track
from cell.devices import DepthCamera, Encoder, EncoderState, Frame
from cell.errors import error
from cell.poses import Array
from cell.samples import Sample
from procedures.belt.config import BeltTrackingConfig
from procedures.belt.items import Item, Outcome, Queue, as_sighting
from procedures.belt.record import PickRecord
from procedures.belt.sight import Sight

KEEP_M = 0.5  # past the zone, so that nothing already dealt with is taken for new
LOOK_BACK_S = 1.0  # an exposure older than this is not asked for any more


class BeltWatch:
    """``with BeltWatch(...)``: listens to both streams; :meth:`learn` takes in what has come.

    ``belt`` is the belt in effect: ``m_per_count`` (m) and ``dir`` (3,).
    """

    def __init__(
        self,
        encoder: Encoder,
        camera: DepthCamera,
        sight: Sight,
        belt: Mapping[str, Any],
        config: BeltTrackingConfig,
    ) -> None:
        self.queue = Queue(config.spacing_m)
        self._scale = Scale(float(belt["m_per_count"]), None, encoder.period_s)
        self._direction = np.array(belt["dir"], dtype=float)
        self.tracker = BeltTracker(BeltEstimator(self._scale), self._direction)
        self._epoch, self._since = encoder.counts.epoch, -np.inf
        self._unplaced: list[Item] = []  # by an encoder that began to count anew
        self._encoder, self._camera, self._sight, self._config = encoder, camera, sight, config
        self._frames: deque[Sample[Frame]] = deque()
        self._undo: list[Any] = []
        self.record: PickRecord | None = None
        self.learnt: Callable[[BeltWatch, Forecast], None] | None = None  # hears of every :meth:`learn`
        flat = self.tracker.direction[:2]
        self._flat_length = float(np.linalg.norm(flat))
        if self._flat_length < 0.5:
            raise error("ARGUMENT_INVALID", "the belt's direction is steeper than 60 degrees")
        self._along = flat / self._flat_length
        self._across = np.array([-self._along[1], self._along[0]])

    def __enter__(self) -> Self:
        self._undo = [
            self._encoder.counts.subscribe(self._count),
            self._camera.frames.subscribe(self._frames.append),
        ]
        return self

    def __exit__(self, *_: object) -> None:
        for undo in self._undo:
            undo()

    @property
    def forecast(self) -> Forecast | None:
        """The belt's motion as it is known now."""
        return self.tracker.belt.forecast()

    def speed(self) -> float:
        """Of the belt, m/s; 0 before anything was counted."""
        forecast = self.forecast
        return 0.0 if forecast is None else forecast.speed(forecast.now)

    def track(self, item: Item) -> Track | None:
        """``item`` as it is foretold now."""
        return self.tracker.track(item.key, self.forecast)

    def along_zone(self, item: Item) -> float:
        """Where ``item`` is now, dot(p, dir) in the base, m; from its place on the belt alone."""
        forecast = self.forecast
        travel = 0.0 if forecast is None else forecast.travel(forecast.now)
        along = item.along + travel * self._flat_length
        rise = float(self.tracker.direction[2])
        return along * self._flat_length + rise * self._config.belt_z_m

    def learn(self) -> list[Item]:
        """Take in what has been seen since; returns the items that are gone, ended or not."""
        forecast = self.forecast
        while self._frames and forecast is not None and self._frames[0].t <= forecast.now:
            self._take(self._frames.popleft(), forecast)
        if forecast is None:
            return []
        far = self._config.zone.max_m + KEEP_M
        gone = [i for i in self.queue.items if self.along_zone(i) > far]
        for item in gone:
            self.queue.items.remove(item)
            self.tracker.forget(item.key)
        if self.queue.length > self._config.queue_limit:
            raise error(
                "BELT_QUEUE_FULL", f"{self.queue.length} items, queue_limit {self._config.queue_limit}"
            )
        if self.learnt is not None:
            self.learnt(self, forecast)
        return gone

    def missed(self, now: float, in_hand: Item | None) -> list[Item]:
        """Items but ``in_hand`` that have left the zone unpicked, or whose place nobody knows any more;
        they end here."""
        out = []
        for item in self._unplaced:
            if item is not in_hand and item.outcome is None:
                self.queue.end(item, Outcome.LOST, now)
                out.append(item)
        self._unplaced = [item for item in self._unplaced if item is in_hand]
        for item in self.queue.items:
            if item is in_hand or item.outcome is not None:
                continue
            if self.along_zone(item) > self._config.zone.max_m:
                seen = item.sightings >= self._config.min_sightings
                self.queue.end(item, Outcome.OUT_OF_ZONE if seen else Outcome.NOT_DETECTED, now)
                out.append(item)
        return out

    def _count(self, sample: Sample[EncoderState]) -> None:
        if self._encoder.counts.epoch != self._epoch:
            self._begin_anew(sample.t)
        self.tracker.belt.add(sample.t, sample.value.count)

    def _begin_anew(self, t: float) -> None:
        """The encoder counts from nothing (its node restarted): where items lie is not known any more."""
        self._epoch, self._since = self._encoder.counts.epoch, t
        self.tracker = BeltTracker(BeltEstimator(self._scale), self._direction)
        self._unplaced += [item for item in self.queue.items if item.outcome is None]
        self.queue.items.clear()

    def _take(self, sample: Sample[Frame], forecast: Forecast) -> None:
        frame = sample.value
        if forecast.now - frame.t_exposure > LOOK_BACK_S or frame.t_exposure < self._since:
            return
        travel = forecast.travel(frame.t_exposure) * self._flat_length
        rows: list[tuple[int, Array, float]] = []
        for view in frame.items or ():
            seen = self._sight.seen(view)
            xy: Array = seen.point[:2]
            item = self.queue.place(float(xy @ self._along) - travel, float(xy @ self._across), seen.yaw)
            if item.sightings == 1:
                item.note(frame.t_exposure, "seen")
            if item.outcome is None:
                sighting = as_sighting(seen.point, frame.t_exposure, self._encoder.counts.clock.now())
                self.tracker.see(item.key, sighting, float(seen.point[2]))
            rows.append((item.number, seen.point, seen.yaw))
        if rows and self.record is not None:
            self.record.saw(frame.t_exposure, frame.seq, rows)
