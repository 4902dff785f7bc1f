"""A total station that speaks GeoCOM, as ``cell.laser_tracker.LaserTracker``."""

import asyncio
import logging
from collections.abc import Awaitable, Callable
from typing import Any, TypeVar

from cell.clock import Clock
from cell.errors import CellError, error
from cell.laser_tracker import LaserTracker, StablePoint, TrackerNoise, TrackerState
from cell.poses import Array
from cell.samples import Quality, Sample, Stream
from drivers.life import SampledDevice
from drivers.tracker.geocom_config import GeocomConfig, ReflectorConfig
from drivers.tracker.geocom_session import GeocomSession, NoAnswer
from drivers.tracker.geocom_station import NO_POINT, Reading, Station
from drivers.tracker.geocom_text import Unreadable
from drivers.tracker.stable import StableWindow
from drivers.tracker.wire import Link, connect

log = logging.getLogger("cellward.devices")

T = TypeVar("T")

_SEARCH_PAUSE_S = 0.1
_FIRST_DISTANCE_S = 1.0
_CLOSE_S = 0.02  # a loop's timer may be early by its resolution
_MOST_MISSES = 2  # distances in a row that fail before the beam counts as broken


class GeocomTracker(SampledDevice):
    """Points are in the frame of ``drivers.tracker.frames``: right-handed, z up, y at the circle's zero.

    ``readings`` has a point only while the instrument is locked and tracks distances, and all of
    :meth:`measure`'s. A tracked distance is older than the angles that it comes with, so such points are for
    aiming and for looking; results come from :meth:`measure`, of a reflector at rest.
    Opening turns nothing; only :meth:`find` does. Reconnecting is the supervisor's business: after an error
    ``close`` and ``open`` again.
    """

    Config = GeocomConfig
    PLAYS = (LaserTracker,)

    def __init__(self, name: str, config: GeocomConfig, clock: Clock) -> None:
        self.noise = TrackerNoise(config.sigma0_m, config.sigma_per_m)
        self.readings: Stream[TrackerState] = Stream(name, clock)
        super().__init__(name, clock, self.readings, config.time_offset_s)
        self._config = config
        self._turn = asyncio.Lock()  # polling, finding and measuring one at a time
        self._link: Link | None = None
        self._session: GeocomSession | None = None
        self._station: Station | None = None
        self._selected: str | None = None
        self._found = False  # a reflector was found, so that one that is missing was lost
        self._locked = self._tracking = False
        self._seq = 0
        self._status = ""

    # -- Device

    async def open(self) -> None:
        """Connect, ask who it is, set it up and poll once; ``DEVICE_UNREACHABLE`` or what it refuses."""
        await self.close()
        self._life.begin()
        self.readings.new_epoch()
        self._selected, self._found, self._locked, self._tracking = None, False, False, False
        self._turn = asyncio.Lock()
        session = GeocomSession(self._write, self._clock, self._config.checksum)
        self._session = session
        self._station = station = Station(self.name, self._config, session, self._clock)
        try:
            self._link = await connect(
                self._config.address, session.received, self._dropped, self._config.connect_timeout_s
            )
            await station.wake()
            self._identity = await station.identify()
            await station.set_up()
            await self._poll(station)
        except OSError as exc:
            await self.close()
            raise self._unreachable(f"{exc}") from exc
        except (NoAnswer, Unreadable) as exc:
            await self.close()
            raise self._unreachable(f"connects, but {exc}") from exc
        except BaseException:
            await self.close()
            raise
        self._life.keep_going(self._poll_on(station), "polling")

    async def close(self) -> None:
        """End polling and the connection; a search under way in the instrument is stopped."""
        await self._life.end()
        link, self._link = self._link, None
        if self._session is not None:
            self._session.end(f"{self.name} was closed")
        if link is not None:
            link.close()
            await asyncio.sleep(0)  # an aborted transport closes its socket on the loop's next turn

    def health(self) -> dict[str, Any]:
        """Age (s), reflector and lock, what the instrument says, and counts of requests and bad replies."""
        last = self.readings.last()
        return {
            "connected": self._life.good,
            "age_s": None if last is None else self._clock.now() - last.t,
            "epoch": self.readings.epoch,
            "reflector": self._selected,
            "locked": self._locked,
            "status": self._status,
            **({} if self._session is None else self._session.counts),
        }

    # -- LaserTracker

    async def select(self, reflector: str) -> None:
        """Write the prism constant of ``reflector`` and read it back; needed once after every opening."""
        if reflector not in self._config.reflectors:
            known = ", ".join(self._config.reflectors)
            raise error("TRACKER_REFLECTOR_UNKNOWN", f"{self.name} has {known}, but not '{reflector}'")
        async with self._turn:
            self._selected = None
            self._tracking = False
            await self._do(lambda station: station.use(self._config.reflectors[reflector]))
            self._selected = reflector

    async def find(self, near: Array | None, timeout: float) -> None:
        """Turn to ``near`` (3,), tracker frame, search around there until there is a reflector, and lock.

        ``TRACKER_NO_TARGET`` when there was none in ``timeout`` s; ``TRACKER_FAULT``, ``TRACKER_REFUSED`` or
        another of the 23xx when the instrument cannot look.
        """
        deadline = self._clock.now() + timeout
        async with self._turn:
            self._found = self._locked = self._tracking = False

            def left() -> float:
                return min(max(deadline - self._clock.now(), _CLOSE_S), self._config.motion_timeout_s)

            async def look(station: Station) -> None:
                failure = error("TRACKER_NO_TARGET", f"{self.name} found nothing in {timeout:g} s")
                try:
                    if near is not None:
                        await station.turn_to(near, left())
                    while left() > _CLOSE_S:
                        try:
                            await station.search(left())
                            await station.lock(left())
                            return
                        except CellError as exc:
                            if exc.name != failure.name:
                                raise
                            failure = exc
                        await self._clock.sleep(_SEARCH_PAUSE_S)
                except NoAnswer as exc:
                    if left() > _CLOSE_S:
                        raise
                    raise failure from exc
                raise failure

            await self._do(look)
            self._found = self._locked = True
            await self._do(lambda station: self._look_once(station, max(deadline - self._clock.now(), 0.0)))

    async def measure(self, window_s: float, max_scatter_m: float, timeout: float) -> Sample[StablePoint]:
        """The mean of distances that were all measured after the call and agree.

        At least ``window_s`` seconds and ``min_readings`` readings, RMS of their distances from the mean at
        most ``max_scatter_m``. ``TRACKER_UNSTABLE`` when that takes longer than ``timeout`` s,
        ``TRACKER_BEAM_BROKEN`` when a reflector that was found gives no distance any more,
        ``TRACKER_NO_TARGET`` when there was none, and ``TRACKER_SETTING`` when the instrument's constant is
        not the selected reflector's any more; one has to be selected then.
        """
        reflector = self._config.reflectors.get(self._selected or "")
        if reflector is None:
            raise error(
                "TRACKER_SETTING", f"no reflector of {self.name} was selected, so its constant is not known"
            )
        window = StableWindow(window_s, max_scatter_m, self._config.min_readings)
        deadline = self._clock.now() + timeout
        async with self._turn:
            return await self._do(
                lambda station: self._measure(station, reflector, window, deadline, timeout)
            )

    async def _measure(
        self,
        station: Station,
        reflector: ReflectorConfig,
        window: StableWindow,
        deadline: float,
        timeout: float,
    ) -> Sample[StablePoint]:
        single = self._config.measure_with == "single"
        self._tracking = not single
        if not single:
            await station.start_tracking()
        misses, distance_time = 0, None
        while (left := deadline - self._clock.now()) > 0:
            wait = min(left, self._config.distance_timeout_s)
            reading = await (station.single(wait) if single else station.read(wait))
            if reading.distance_time is not None and reading.distance_time == distance_time:
                await self._clock.sleep(0.02)  # the same distance once more
                continue
            distance_time = reading.distance_time
            if reading.point is not None:
                self._found = self._locked = True
                misses = 0
                pushed = self._push(reading)
                if window.add(pushed.t, pushed.dt, reading.point, reading.warning):
                    await self._require_constant(station, reflector)
                    return window.sample(pushed.seq, *await station.air())
                continue
            if reading.code.meaning not in NO_POINT:
                raise reading.code.as_error(self.name)
            window.restart()
            misses += 1
            locked = await station.is_locked()
            self._locked = bool(locked)
            self._push(reading)
            if locked is False or misses >= _MOST_MISSES:
                raise self._lost_target(reading)
        raise window.unstable(self.name, timeout)

    async def _require_constant(self, station: Station, reflector: ReflectorConfig) -> None:
        """Somebody at the panel may have set another one, which no scatter shows."""
        try:
            await station.require(reflector)
        except CellError:
            self._selected = None
            raise

    # -- polling

    async def _poll_on(self, station: Station) -> None:
        while self._life.good:
            await self._until_poll()
            if self._turn.locked():
                continue
            async with self._turn:
                try:
                    await self._do(self._poll)
                except CellError as exc:
                    if not self._life.good:
                        return
                    self._tell(str(exc))

    async def _until_poll(self) -> None:
        """The pause before each poll. A replay puts the recorded instants of polls in its place."""
        await self._clock.sleep(self._config.poll_period_s)

    async def _poll(self, station: Station) -> None:
        locked = await station.is_locked()
        if locked is not None:
            self._locked = locked
        reading = await self._look_once(station, 0.0)
        if locked is None and self._tracking and reading.point is None:
            self._locked = False  # it does not tell; that there is no distance has to do

    async def _look_once(self, station: Station, wait_s: float) -> Reading:
        """Push one reading, with a point if it is locked; the first of tracking is waited for."""
        if self._locked and not self._tracking and self._config.tracking != "off":
            await station.start_tracking()
            self._tracking = True
            wait_s = max(wait_s, _FIRST_DISTANCE_S)
        wait_s = min(wait_s, self._config.distance_timeout_s)
        reading = await (station.read(wait_s) if self._locked and self._tracking else station.angles())
        self._push(reading)
        return reading

    def _push(self, reading: Reading) -> Sample[TrackerState]:
        status = reading.warning
        self._tell(status)
        quality = Quality.GOOD if not status else Quality.DEGRADED
        self._seq += 1
        sample = Sample(
            TrackerState(reading.point, self._locked, status),
            reading.t - self._config.time_offset_s,
            reading.dt,
            self._seq,
            quality,
        )
        self.readings.push(sample)
        return sample

    def _tell(self, status: str) -> None:
        """One line when the instrument begins to complain of something else."""
        if status and status != self._status:
            log.info("%s says %s", self.name, status)
        self._status = status

    # -- loss

    async def _do(self, what: Callable[[Station], Awaitable[T]]) -> T:
        """With the open station; no answer ends the link, and so does a reply that cannot be understood."""
        station = self._opened(self._station)
        try:
            return await what(station)
        except NoAnswer as exc:
            failure = error("DEVICE_LOST", f"{self.name} at {self._config.url}: {exc}")
        except Unreadable as exc:
            failure = error("PROTOCOL_VIOLATION", f"{self.name} at {self._config.url}: {exc}")
        self._life.lose(failure)
        raise self._life.failure or failure  # another one may have been first

    def _write(self, data: bytes) -> None:
        if self._link is not None:
            self._link.write(data)

    def _dropped(self, reason: str) -> None:
        if self._session is not None:
            self._session.end(reason)
        self._life.lose(error("DEVICE_LOST", f"{self.name} at {self._config.url}: {reason}"))

    def _unreachable(self, what: str) -> CellError:
        return error("DEVICE_UNREACHABLE", f"{self.name} at {self._config.url}: {what}")

    def _lost_target(self, reading: Reading) -> CellError:
        name = "TRACKER_BEAM_BROKEN" if self._found else "TRACKER_NO_TARGET"
        return error(name, f"{self.name} says {reading.code}")
