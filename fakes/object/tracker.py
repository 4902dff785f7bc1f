"""The laser tracker of the object face: the driver's Protocol attached straight to the world."""

import numpy as np
from pydantic import Field

from cell.clock import Clock
from cell.devices import Identity
from cell.errors import CellError, error
from cell.formats.reading import Strict
from cell.laser_tracker import (
    MOST_SIGMA0_M,
    MOST_SIGMA_PER_M,
    LaserTracker,
    StablePoint,
    TrackerNoise,
    TrackerState,
)
from cell.poses import Array
from cell.samples import Sample
from fakes.object._lazy import LazyStream
from fakes.object._plant import ObjectDevice
from fakes.object.registry import cell_of
from fakes.world.tracker.tracker import MULTIPLE, NO_TARGET, NOT_AIMED, Reading, polar

_CONSTANT_TOLERANCE_M = 1e-6
_BACKFILL = 10  # readings; each is a look along the beam, and who asks late wants the newest
_DOUBT = "the instrument does not vouch for the accuracy of its readings"


class ObjectReflectorConfig(Strict):
    """The constant of one reflector."""

    constant_m: float = Field(ge=-0.2, le=0.2)


class ObjectTrackerConfig(Strict):
    """Keys of a device with ``driver = "fakes.object:ObjectTracker"``."""

    scenario: str = Field(description="scenario file, or the name of a shipped one")
    expect_serial: str | None = None
    reflectors: dict[str, ObjectReflectorConfig] = Field(
        default={}, description="by name; without any those of the scenario, as their labels say"
    )
    sigma0_m: float | None = Field(
        default=None, gt=0, le=MOST_SIGMA0_M, description="stated noise; else the true one"
    )
    sigma_per_m: float | None = Field(default=None, ge=0, le=MOST_SIGMA_PER_M)
    min_readings: int = Field(default=3, ge=2, le=1000)
    reply_s: float = Field(default=0.002, ge=0, le=0.02)
    lost_after_s: float = Field(default=1.0, gt=0, le=10)


class ObjectTracker(ObjectDevice):
    """``cell.laser_tracker.LaserTracker`` on virtual time; it follows the reflector that it found."""

    Config = ObjectTrackerConfig
    PLAYS = (LaserTracker,)

    def __init__(self, name: str, config: ObjectTrackerConfig, clock: Clock) -> None:
        self._cell = cell_of(config.scenario, clock)
        self.tracker_plant = self._cell.tracker
        super().__init__(name, clock, self.tracker_plant, config.lost_after_s)
        self.config, self.world = config, self._cell.world
        self._tracker = self.tracker_plant.tracker
        truth = self._tracker.truth
        sigma0 = truth.sigma0_m if config.sigma0_m is None else config.sigma0_m
        sigma_per_m = truth.sigma_per_m if config.sigma_per_m is None else config.sigma_per_m
        self.noise = TrackerNoise(sigma0, sigma_per_m)
        labels = {name: r.labelled_constant_m for name, r in self._tracker.reflectors.items()}
        self._selected: str | None = None
        self._constants = {name: r.constant_m for name, r in config.reflectors.items()} or labels
        half_s = config.reply_s / 2.0
        self.readings: LazyStream[TrackerState] = LazyStream(
            f"{name}.readings",
            clock,
            1.0 / truth.rate_hz,
            self._read,
            dt=half_s,
            delay_s=half_s,
            backfill=_BACKFILL,
        )
        self.stream = self.readings

    async def open(self) -> None:
        """Connect; ``DEVICE_UNREACHABLE`` while the instrument refuses."""
        self._selected = None
        await super().open()
        self._cell.start()

    async def identify(self) -> Identity:
        """Which instrument this is; ``DEVICE_IDENTITY`` when the config expects another serial."""
        self._check_link()
        serial, expected = self.tracker_plant.serial, self.config.expect_serial
        if expected is not None and serial != expected:
            raise error("DEVICE_IDENTITY", f"{self.name} has serial {serial}, expected {expected}")
        return Identity(self._tracker.truth.name, serial, self._tracker.truth.version)

    async def select(self, reflector: str) -> None:
        """Set the constant of this reflector, or ``TRACKER_REFLECTOR_UNKNOWN``."""
        if reflector not in self._constants:
            known = ", ".join(self._constants)
            raise error(
                "TRACKER_REFLECTOR_UNKNOWN", f"{self.name} has no reflector {reflector!r}; it has {known}"
            )
        await self._pass(2.0 * self.config.reply_s)
        self.tracker_plant.settle_past()
        self._tracker.constant_m = self._constants[reflector]
        self._selected = reflector

    async def find(self, near: Array | None, timeout: float) -> None:
        """Turn to ``near``, search there until ``timeout`` and lock; ``TRACKER_NO_TARGET``."""
        give_up, tracker = self.clock.now() + timeout, self._tracker
        if near is not None:
            hz, v = polar(np.asarray(near, dtype=float))
            await self._pass(tracker.turning_s(self.clock.now(), hz, v))
            self.tracker_plant.settle_past()
            tracker.turn_to(self.clock.now(), hz, v)
        tracker.follow(self.clock.now(), True)
        while True:
            await self._pass(max(tracker.truth.search_s, 0.01))
            self.tracker_plant.settle_past()
            half = tracker.truth.search_rad
            status = tracker.search(self.clock.now(), half, half)
            if not status:
                await self._pass(2.0 * self.readings.period_s)  # who looks now shall see that it is locked
                return
            if self.clock.now() >= give_up:
                raise error("TRACKER_NO_TARGET", f"{self.name}: {status} within {half:g} rad of its aim")

    async def measure(self, window_s: float, max_scatter_m: float, timeout: float) -> Sample[StablePoint]:
        """Wait for a window of readings that agree; see :class:`cell.laser_tracker.LaserTracker`.

        ``TRACKER_SETTING`` until a reflector was selected, and when the constant is not its own any more.
        """
        self._require_constant()
        begin, truth = self.clock.now(), self._tracker.truth
        each = max(round(truth.measure_s * truth.rate_hz), 1) if truth.one_by_one else 1
        window_s = max(window_s, self.config.min_readings * each / truth.rate_hz)
        unsubscribe = self.readings.subscribe(lambda sample: None)
        try:
            while True:
                await self._pass(window_s)
                now = self.clock.now()
                samples = self.readings.between(max(begin, now - window_s), now)
                lost, samples = _without_point(samples), samples[::-each][::-1]
                if not lost and len(samples) >= self.config.min_readings:
                    point = self._stable(samples, window_s)
                    if point.scatter_m <= max_scatter_m:
                        self._require_constant()
                        first, last = samples[0], samples[-1]
                        half = 0.5 * (last.t - first.t) + last.dt
                        return Sample(point, 0.5 * (first.t + last.t), half, last.seq)
                    found = f"scatter {point.scatter_m * 1e3:.3f} mm, limit {max_scatter_m * 1e3:.3f} mm"
                elif lost:
                    raise self._no_point(lost)
                else:
                    found = f"{len(samples)} readings, at least {self.config.min_readings} are needed"
                if now >= begin + timeout:
                    raise error("TRACKER_UNSTABLE", f"{self.name}: {found}, after {timeout:g} s")
        finally:
            unsubscribe()

    def inject(self, kind: str, **arguments: object) -> None:
        """Begin a fault of the tracker or of its link, by its name in the vocabulary."""
        self.tracker_plant.inject(kind, arguments)

    def _stable(self, samples: list[Sample[TrackerState]], window_s: float) -> StablePoint:
        points = np.array([sample.value.point for sample in samples])
        mean = points.mean(axis=0)
        scatter = float(np.sqrt(np.mean(np.sum((points - mean) ** 2, axis=1))))
        truth = self._tracker.truth
        warnings = (_DOUBT,) if any(sample.value.status for sample in samples) else ()
        return StablePoint(
            mean, scatter, len(points), window_s, truth.temperature_c, truth.pressure_pa, warnings
        )

    def _no_point(self, status: str) -> CellError:
        kind = "TRACKER_NO_TARGET" if status in (NOT_AIMED, NO_TARGET, MULTIPLE) else "TRACKER_BEAM_BROKEN"
        return error(kind, f"{self.name}: {status}")

    def _read(self, t: float, tick: int) -> TrackerState:
        reading: Reading = self._tracker.read(t)
        status = _DOUBT if reading.doubtful and reading.point is not None else reading.status
        return TrackerState(reading.point, reading.point is not None, status)

    def _require_constant(self) -> None:
        self._check_link()
        if self._selected is None:
            raise error("TRACKER_SETTING", f"no reflector of {self.name} was selected")
        found, wanted = self._tracker.constant_m, self._constants[self._selected]
        if abs(found - wanted) > _CONSTANT_TOLERANCE_M:
            self._selected = None
            raise error(
                "TRACKER_SETTING",
                f"{self.name} has the constant {1e3 * found:.3f} mm instead of {1e3 * wanted:.3f} mm",
            )

    def _check_link(self) -> None:
        if self.lost is not None:
            raise error(self.lost.name, self.lost.detail)

    async def _pass(self, seconds: float) -> None:
        """Let time go by; raise at once when the link is lost meanwhile."""
        until = self.clock.now() + seconds
        self._check_link()
        while (left := until - self.clock.now()) > 1e-9:
            await self.wait_change(left)
            self._check_link()


def _without_point(samples: list[Sample[TrackerState]]) -> str:
    """Why one of the readings has no point; empty when all have."""
    return next((sample.value.status for sample in samples if sample.value.point is None), "")
