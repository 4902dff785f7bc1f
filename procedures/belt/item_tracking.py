"""What encoder and camera say, turned into items on the belt."""

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from calibration.belt.estimator import BeltEstimator
from calibration.belt.estimator import EncoderScale as Scale
from calibration.belt.forecast import TravelForecast
from calibration.belt.slip import SightedPlaces, Slip, SlipWatch
from calibration.belt.tracking import BeltTracker, ItemTrack
from cell.devices import DepthCamera, Encoder, EncoderState, Frame
from cell.errors import error
from cell.poses import Array
from cell.samples import Sample
from procedures.belt.camera_stall import Stall
from procedures.belt.camera_to_belt import CameraToBelt, SeenItem
from procedures.belt.config import BeltTrackingConfig
from procedures.belt.count_origin import CountOrigin
from procedures.belt.encoder_alarms import Emergencies
from procedures.belt.items import Item, Outcome, Queue, as_sighting
from procedures.belt.record import PickRecord

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
        camera_to_belt: CameraToBelt,
        belt: Mapping[str, Any],
        config: BeltTrackingConfig,
    ) -> None:
        self.queue = Queue(config.spacing_m)
        self._scale = Scale(float(belt["m_per_count"]), None, encoder.period_s)
        self._direction = np.array(belt["dir"], dtype=float)
        self.tracker = BeltTracker(BeltEstimator(self._scale), self._direction)
        #: The belt's motion as it was last learnt: counts come all the time, and each changes it a little.
        self.forecast: TravelForecast | None = None
        self._tracks: dict[int, ItemTrack | None] = {}  # as it predicts them
        self._since = -np.inf
        self._unplaced: list[Item] = []  # by an encoder that began to count anew
        self._over: list[tuple[Item, Outcome]] = []  # more than the queue takes
        self.slips: list[Slip] = []
        self.stall = Stall(config.camera_stall_s)
        self.late = 0  # pictures that came longer than LOOK_BACK_S after their exposure
        self._slip_watch, self._doubted = SlipWatch(config.spacing_m), list[_Look]()
        self.tell: Callable[..., None] = lambda event, **what: None  # what an operator should know
        self.emergencies = Emergencies(encoder, lambda what: self.tell("encoder emergency", what=what))
        self.origin = CountOrigin(encoder, belt, lambda event, **what: self.tell(event, **what))
        self._encoder, self._camera, self._camera_to_belt, self._config = (
            encoder,
            camera,
            camera_to_belt,
            config,
        )
        self._frames: deque[Sample[Frame]] = deque()
        self._undo: list[Any] = []
        self.record: PickRecord | None = None
        self.learnt: Callable[[BeltWatch, TravelForecast], None] | None = None  # after each :meth:`learn`
        flat = self.tracker.direction[:2]
        self._flat_length = float(np.linalg.norm(flat))
        if self._flat_length < 0.5:
            raise error("ARGUMENT_INVALID", "the belt's direction is steeper than 60 degrees")
        self._along = flat / self._flat_length
        self._across = np.array([-self._along[1], self._along[0]])

    def __enter__(self) -> Self:
        self._undo = [
            self._encoder.counts.subscribe(self._count),
            self._camera.frames.subscribe(self._frame),
        ]
        return self

    def __exit__(self, *_: object) -> None:
        for undo in self._undo:
            undo()

    def speed(self) -> float:
        """Of the belt, m/s; 0 before anything was counted."""
        forecast = self.forecast
        return 0.0 if forecast is None else forecast.speed(forecast.now)

    def doubt(self, ahead_s: float) -> float:
        """Standard deviation of the belt's travel over the next ``ahead_s``, m."""
        forecast = self.forecast
        return np.inf if forecast is None else forecast.sigma(forecast.now, forecast.now + ahead_s)

    def track(self, item: Item) -> ItemTrack | None:
        """``item`` as it is predicted now, until :meth:`learn` knows more."""
        if item.number not in self._tracks:
            self._tracks[item.number] = self.tracker.track(item.key, self.forecast)
        return self._tracks[item.number]

    def seen_at(self, item: Item) -> Array:
        """Where ``item`` was seen (k, 3), m in the base."""
        return np.array([[*sighting.xy, z] for sighting, z in self.tracker.sightings(item.key)])

    def along_zone(self, item: Item) -> float:
        """Where ``item`` is now, dot(p, dir) in the base, m; from its place on the belt alone."""
        forecast = self.forecast
        travel = 0.0 if forecast is None else forecast.travel(forecast.now)
        along = item.along + travel * self._flat_length
        rise = float(self.tracker.direction[2])
        return along * self._flat_length + rise * self._config.belt_z_m

    def learn(self) -> None:
        """Take in what has been seen since, and forget the items that have ended and are far past.

        ``BELT_ASTRAY`` when counts and pictures have not agreed for too long.
        """
        now = self._encoder.counts.clock.now()
        forecast = self.forecast = self.tracker.belt.forecast()
        self.tracker.belt.keep_up()
        self._tracks.clear()
        if (waited := self.stall.look(now)) is not None:
            self.tell("camera stall" if self.stall.on else "camera back", waited_s=round(waited, 3))
        while self._frames and forecast is not None and self._frames[0].t <= forecast.now:
            self._take(self._frames.popleft().value, forecast)
        if forecast is None:
            return
        past = self.queue.beyond(self._from_zone(self._config.zone.max_m + KEEP_M, forecast))
        if gone := [item for item in past if item.outcome is not None]:
            self.queue.keep([item for item in self.queue.items if item not in gone])
            for item in gone:
                self.tracker.forget(item.key)
        if self.learnt is not None:
            self.learnt(self, forecast)

    def missed(self, now: float, in_hand: Item | None) -> list[tuple[Item, Outcome]]:
        """Items but ``in_hand`` that have left the zone unpicked, or whose place is not known any more;
        they end here, with that outcome."""
        out, self._over = self._over, []
        for item in self._unplaced:
            if item is not in_hand and item.outcome is None:
                out.append(self._ended(item, Outcome.LOST, now))
        self._unplaced = [item for item in self._unplaced if item is in_hand]
        if (forecast := self.forecast) is None:
            return out
        for item in self.queue.beyond(self._from_zone(self._config.zone.max_m, forecast)):
            if item is in_hand or item.outcome is not None:
                continue
            seen = item.sightings >= self._config.min_sightings
            out.append(self._ended(item, Outcome.OUT_OF_ZONE if seen else Outcome.NOT_DETECTED, now))
        return out

    def _ended(self, item: Item, outcome: Outcome, now: float) -> tuple[Item, Outcome]:
        self.queue.end(item, outcome, now)
        return item, outcome

    def _from_zone(self, along: float, forecast: TravelForecast) -> float:
        """The place on the belt (m, zero travel) that is now at ``along`` of the zone (m)."""
        level = along - float(self.tracker.direction[2]) * self._config.belt_z_m
        return level / self._flat_length - forecast.travel(forecast.now) * self._flat_length

    def _count(self, sample: Sample[EncoderState]) -> None:
        if self.origin.moved(sample):
            self._begin_anew(sample.t)
        self.emergencies.count(sample)
        self.tracker.belt.add(sample.t, sample.value.count)

    def _begin_anew(self, t: float) -> None:
        """The encoder counts from elsewhere (its node restarted, or somebody set its position): where items
        lie is not known any more."""
        self._since = t
        self.tracker, self.forecast = BeltTracker(BeltEstimator(self._scale), self._direction), None
        self._tracks.clear()
        self._unplaced += [item for item in self.queue.items if item.outcome is None]
        self.queue.keep([])
        self._slip_watch, self._doubted = SlipWatch(self._config.spacing_m), []

    def _frame(self, sample: Sample[Frame]) -> None:
        now = self._encoder.counts.clock.now()
        self.stall.picture(now)
        self.late += now - sample.t > LOOK_BACK_S
        self._frames.append(sample)
        while self._frames[0].t < sample.t - LOOK_BACK_S:
            self._frames.popleft()

    def _take(self, frame: Frame, forecast: TravelForecast) -> None:
        """Hold the frame back while it is in doubt, and with it those that it makes credible."""
        if forecast.now - frame.t_exposure > LOOK_BACK_S or frame.t_exposure < self._since:
            return
        look = _Look(frame, self._camera_to_belt.seen(frame.items or ()))
        sigma = max((view.sigma_m for view in frame.items or ()), default=0.0)
        along = forecast.travel(frame.t_exposure) * self._flat_length
        trust = self._slip_watch.look(
            SightedPlaces(frame.t_exposure, along, self._places(look, forecast), sigma)
        )
        self._doubted.append(look)
        if trust is None:
            if (astray := self._slip_watch.astray_s) is not None:
                raise error("BELT_ASTRAY", f"for {astray:.1f} s no two pictures have agreed with the counts")
            return
        if trust.slip is not None:
            self._slipped(trust.slip)
        believed = [old for old in self._doubted if old is look or old.frame.t_exposure >= trust.since]
        self._doubted = []
        for old in believed:
            self._enter(old, self._places(old, forecast))

    def _places(self, look: "_Look", forecast: TravelForecast) -> Array:
        """Along and across (k, 2), m at zero travel, of what a frame showed."""
        xy = np.array([seen.point[:2] for seen in look.seen]).reshape(-1, 2)
        out: Array = xy @ np.stack([self._along, self._across], axis=1)
        out[:, 0] -= [self._flat_length * forecast.travel(t) for t in look.times]
        return out

    def _slipped(self, slip: Slip) -> None:
        """Everything seen before lies elsewhere than the counts say."""
        self.slips.append(slip)
        self.tracker.slipped(slip)
        self.queue.shift(slip.by)
        ahead, sigma = -slip.by / self._flat_length, slip.sigma / self._flat_length
        what = {"ahead_m": round(ahead, 6), "sigma_m": round(sigma, 6), "items": slip.items}
        self.tell("encoder slip", before_s=round(slip.t, 4), **what)

    def _enter(self, look: "_Look", places: Array) -> None:
        """Each sighting becomes one of its item."""
        frame, now = look.frame, self._encoder.counts.clock.now()
        order = np.argsort(-places[:, 0])
        sightings, times = [look.seen[k] for k in order], [look.times[k] for k in order]
        items = self.queue.place(places[order], [seen.yaw for seen in sightings])
        new = [item for item in items if item.sightings == 1]
        for item in new:
            item.note(frame.t_exposure, "seen")
        while self.queue.length > self._config.queue_limit:  # who comes first is in it
            self._over.append(self._ended(new.pop(), Outcome.QUEUE_FULL, now))
        for item, seen, t in zip(items, sightings, times, strict=True):
            if item.outcome is None:
                sighting = as_sighting(seen.point, t, now, seen.sigma_m)
                self.tracker.see(item.key, sighting, float(seen.point[2]))
        if items:
            self._camera_to_belt.told = frame.intrinsics
        if items and self.record is not None:
            self.record.camera = self.record.camera or self._camera_to_belt.camera(frame.intrinsics)
            rows = [
                (item.number, seen.point, seen.yaw, seen.sigma_m)
                for item, seen in zip(items, sightings, strict=True)
            ]
            for t in sorted(set(times)):  # one of a global shutter, one for each row of a rolling one
                here = [row for row, at in zip(rows, times, strict=True) if at == t]
                self.record.saw(t, frame.seq, here)


@dataclass(frozen=True, eq=False)
class _Look:
    """One frame, and what it shows in the base."""

    frame: Frame
    seen: list[SeenItem]

    @property
    def times(self) -> list[float]:
        """When the row was exposed on which each item lies."""
        return [self.frame.t_of(view.point) for view in self.frame.items or ()]
