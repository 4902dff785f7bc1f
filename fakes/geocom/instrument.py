"""A total station as GeoCOM shows it: procedures by number, what they take, do, need in time, and return.

What it measures is the world's tracker. Procedures that it does not have end with code 5.
"""

import asyncio
import logging
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from math import inf, isfinite, pi

from fakes.geocom.edm import CLEAR, DISTANCE, PROGRAMS, RAPID_TRACK, STOP, Edm
from fakes.geocom.settings import INSTRUMENTS_WAVELENGTH_M, PRISM_CONSTANTS, Settings
from fakes.geocom.text import Value
from fakes.tracker import MULTIPLE, Reading, Tracker

log = logging.getLogger("cellward.twin.tracker")

OK, IVPARAM, FATAL, NOT_IMPL, ABORT = 0, 2, 4, 5, 8
DOUBT, NO_DISTANCE, DISTANCE_ERROR = 1284, 1285, 1292
NO_TARGET, MULTIPLE_TARGETS, NOT_ENABLED, NO_LOCK = 8710, 8711, 8714, 8725
CANNOT_DECODE = 3080
_PA_PER_MBAR = 100.0
_ATR_RAD = 0.008  # half the view of the target recognition, which no search window undercuts
_QUICK_S = 2.0
_ANGLE_ACCURACY_RAD = 2.4e-6

Answer = tuple[int, tuple[Value, ...]]
Parameters = tuple[float, ...]


@dataclass(frozen=True)
class _Procedure:
    takes: int
    act: Callable[[Parameters], Awaitable[Answer] | Answer]


class Instrument:
    """One station; its procedures are carried out one at a time."""

    def __init__(self, tracker: Tracker, now: Callable[[], float], delay_s: float = 0.005) -> None:
        self.tracker, self.now, self.delay_s = tracker, now, delay_s
        self.serial = tracker.truth.serial
        self.edm = Edm(tracker, now)
        self.forced: dict[int, int] = {}  # return codes that a fault gives to procedures
        self._turn = asyncio.Lock()
        self._moving: asyncio.Task[Answer] | None = None
        self._procedures = self._table()
        self.restart()

    def restart(self, serial: str | None = None) -> None:
        """Settings are as at first; with ``serial`` another instrument is in its place."""
        truth = self.tracker.truth
        air = [INSTRUMENTS_WAVELENGTH_M, truth.pressure_pa / _PA_PER_MBAR, truth.temperature_c]
        self.settings = Settings(air=[*air, truth.temperature_c])
        self.serial = serial or self.serial
        self.edm = Edm(self.tracker, self.now)

    async def call(self, rpc: int, parameters: tuple[str, ...]) -> Answer:
        """Carry out one procedure."""
        async with self._turn:
            await asyncio.sleep(self.delay_s)
            forced = self.forced.get(rpc, self.forced.get(-1))
            if forced is not None and forced not in (1283, DOUBT):
                return forced, ()
            procedure = self._procedures.get(rpc)
            if procedure is None:
                return NOT_IMPL, ()
            try:
                numbers = tuple(float(text) for text in parameters)
            except ValueError:
                return CANNOT_DECODE, ()
            if len(numbers) != procedure.takes:
                return CANNOT_DECODE, ()
            if not all(map(isfinite, numbers)):
                return IVPARAM, ()
            code, values = await self._carry_out(procedure, numbers)
            return (forced if forced is not None and code == OK else code), values

    def abort(self) -> None:
        """Stop the procedure that runs."""
        if self._moving is not None:
            self._moving.cancel()

    async def _carry_out(self, procedure: _Procedure, numbers: Parameters) -> Answer:
        async def act() -> Answer:
            result = procedure.act(numbers)
            return await result if isinstance(result, Awaitable) else result

        self._moving = asyncio.get_running_loop().create_task(act())
        try:
            await asyncio.wait([self._moving])
        finally:
            moving, self._moving = self._moving, None
            moving.cancel()
        if moving.cancelled():
            return ABORT, ()
        if exc := moving.exception():
            log.error("the twin's station failed", exc_info=exc)
            return FATAL, ()
        return moving.result()

    def _table(self) -> dict[int, _Procedure]:
        p = _Procedure
        settings = {
            107: p(1, self._set_digits),
            108: p(0, lambda a: (OK, (self.settings.digits,))),
            2006: p(1, lambda a: self._set("compensator", bool(a[0]))),
            2007: p(0, lambda a: (OK, (self.settings.compensator,))),
            2009: p(0, lambda a: (OK, tuple(self.settings.station))),
            2010: p(4, lambda a: self._set("station", list(a))),
            2011: p(0, lambda a: (OK, (self.settings.reflector_height,))),
            2012: p(1, lambda a: self._set("reflector_height", a[0])),
            2020: p(1, lambda a: self._set("edm_mode", int(a[0]), 0 <= a[0] <= 20)),
            2021: p(0, lambda a: (OK, (self.settings.edm_mode,))),
            2023: p(0, lambda a: (OK, (self.tracker.constant_m,))),
            2024: p(1, self._set_constant),
            2026: p(0, lambda a: (OK, (0,))),
            2028: p(4, lambda a: self._set("air", list(a), 500.0 <= a[1] <= 1200.0)),
            2029: p(0, lambda a: (OK, tuple(self.settings.air))),
            9018: p(1, self._set_atr),
            9019: p(0, lambda a: (OK, (self.settings.atr,))),
            9020: p(1, self._set_lock),
            9021: p(0, lambda a: (OK, (self.settings.lock,))),
            17008: p(1, self._set_prism),
            17009: p(0, lambda a: (OK, (self.settings.prism_type,))),
        }
        version = tuple(int(part) for part in self.tracker.truth.version.split("."))
        identity = {
            0: p(0, lambda a: (OK, ())),
            110: p(0, lambda a: (OK, (3, 1, 0))),
            5003: p(0, lambda a: (OK, (int(self.serial),))),
            5004: p(0, lambda a: (OK, (self.tracker.truth.name,))),
            5034: p(0, lambda a: (OK, version)),
        }
        measuring = {
            2008: p(2, self._do_measure),
            2082: p(2, self._coordinate),
            2107: p(1, lambda a: (OK, self._aim())),
            2108: p(2, self._simple),
            2116: p(2, self._simple_coordinate),
            2117: p(0, self._quick),
            2167: p(2, self._full),
            17017: p(1, self._measure_distance_angle),
        }
        aiming = {
            6021: p(0, lambda a: (OK, (int(self._locked()),))),
            9013: p(0, self._lock_in),
            9027: p(5, self._position),
            9037: p(3, lambda a: self._fine_adjust(a[0], a[1])),
        }
        return settings | identity | measuring | aiming

    # -- settings

    def _set(self, name: str, value: object, valid: bool = True) -> Answer:
        if not valid:
            return IVPARAM, ()
        setattr(self.settings, name, value)
        return OK, ()

    def _set_digits(self, a: Parameters) -> Answer:
        return self._set("digits", int(a[0]), 0 <= a[0] <= 15)

    def _set_constant(self, a: Parameters) -> Answer:
        if not abs(a[0]) <= 0.2:
            return IVPARAM, ()
        self.tracker.constant_m = a[0]
        return OK, ()

    def _set_prism(self, a: Parameters) -> Answer:
        if int(a[0]) not in PRISM_CONSTANTS:
            return IVPARAM, ()
        self.tracker.constant_m = PRISM_CONSTANTS[int(a[0])]
        return self._set("prism_type", int(a[0]))

    def _set_atr(self, a: Parameters) -> Answer:
        """Target recognition on or off; either ends following."""
        self.tracker.follow(self.now(), False)
        self.settings.lock = False
        return self._set("atr", bool(a[0]))

    def _set_lock(self, a: Parameters) -> Answer:
        """Following is allowed, and begins with :meth:`_lock_in`; or it ends."""
        if a[0]:
            self.settings.atr = True
        else:
            self.tracker.follow(self.now(), False)
        return self._set("lock", bool(a[0]))

    # -- turning and searching

    async def _position(self, a: Parameters) -> Answer:
        """Turn to (hz, v); with the ATR mode (fourth parameter) aim at the reflector there."""
        hz, v = a[0], a[1]
        if not 0.0 <= v <= pi:
            return IVPARAM, ()
        self.tracker.release(self.now())
        await asyncio.sleep(self.tracker.turning_s(self.now(), hz, v))
        self.tracker.turn_to(self.now(), hz, v)
        return await self._fine_adjust(0.0, 0.0) if a[3] else (OK, ())

    async def _fine_adjust(self, width: float, height: float) -> Answer:
        """Search a window about the aim for the nearest reflector and aim at it."""
        if not self.settings.atr:
            return NOT_ENABLED, ()
        if not (0.0 <= width <= pi and 0.0 <= height <= pi):
            return IVPARAM, ()
        await asyncio.sleep(self.tracker.truth.search_s)
        status = self.tracker.search(self.now(), max(width / 2, _ATR_RAD), max(height / 2, _ATR_RAD))
        if not status:
            return OK, ()
        return (MULTIPLE_TARGETS if status == MULTIPLE else NO_TARGET), ()

    def _lock_in(self, a: Parameters) -> Answer:
        if not self.settings.lock:
            return NOT_ENABLED, ()
        self.tracker.advance(self.now())
        if self.tracker.target is None:
            return NO_LOCK, ()
        self.tracker.follow(self.now(), True)
        return OK, ()

    def _locked(self) -> bool:
        self.tracker.advance(self.now())
        return self.settings.lock and self.tracker.follows and self.tracker.target is not None

    # -- measuring

    def _do_measure(self, a: Parameters) -> Answer:
        if int(a[0]) not in PROGRAMS:
            return IVPARAM, ()
        self.edm.start(int(a[0]))
        return OK, ()

    async def _full(self, a: Parameters) -> Answer:
        code, reading, (hz, v) = await self._measured(a[0])
        slope, stamp = (reading.slope, _ms(reading.t)) if reading is not None else (0.0, 0)
        return code, (hz, v, _ANGLE_ACCURACY_RAD, 0.0, 0.0, 0.0, slope, float(stamp))

    async def _simple(self, a: Parameters) -> Answer:
        code, reading, (hz, v) = await self._measured(a[0])
        return code, (hz, v, 0.0 if reading is None else reading.slope)

    async def _coordinate(self, a: Parameters) -> Answer:
        code, reading, _ = await self._measured(a[0])
        place, stamp = self._place(reading), _ms(reading.t) if reading is not None else 0
        return code, (*place, stamp, *place, stamp)

    async def _simple_coordinate(self, a: Parameters) -> Answer:
        code, reading, _ = await self._measured(a[0])
        return code, self._place(reading)

    async def _quick(self, a: Parameters) -> Answer:
        if not self.edm.tracks:
            self.edm.start(RAPID_TRACK)
        return await self._simple((1e3 * _QUICK_S, 0.0))

    async def _measure_distance_angle(self, a: Parameters) -> Answer:
        """Whole measurements: 0 the last one, 1 angles, 2 a distance, 3 and 4 track, 5 clear, 6 stop."""
        mode = int(a[0])
        if mode not in range(7):
            return IVPARAM, ()
        if mode in (5, 6):
            self.edm.start(CLEAR if mode == 5 else STOP)
        if mode in (1, 5, 6):
            return OK, (*self._aim(), 0.0, mode)
        if mode == 2:
            if self.settings.atr and self.tracker.read(self.now()).point is None:
                code, _ = await self._fine_adjust(0.0, 0.0)
                if code != OK:
                    return code, (*self._aim(), 0.0, mode)
            self.edm.start(DISTANCE)
        elif mode in (3, 4) and not self.edm.tracks:
            self.edm.start(RAPID_TRACK)
        code, values = await self._simple((0.0 if mode == 0 else 1e3 * _QUICK_S, 0.0))
        return code, (*values, mode)

    async def _measured(self, wait_ms: float) -> tuple[int, Reading | None, tuple[float, float]]:
        """Return code, the distance if there is one, and the angles that go with it."""
        reading = await self.edm.wait(min(max(wait_ms, 0.0), 60e3) / 1e3)
        if reading is None:
            return NO_DISTANCE, None, self._aim()
        if reading.point is None:
            return DISTANCE_ERROR, None, self._aim()
        return (DOUBT if reading.doubtful else OK), reading, (reading.hz, reading.v)

    def _aim(self) -> tuple[float, float]:
        return self.tracker.aim(self.now())

    def _place(self, reading: Reading | None) -> tuple[float, float, float]:
        """Easting, northing and height of a point, of the station too."""
        if reading is None or reading.point is None:
            return 0.0, 0.0, 0.0
        e, n, h, height = self.settings.station
        x, y, z = reading.point.tolist()
        return e + x, n + y, h + height + z - self.settings.reflector_height


def _ms(t: float) -> int:
    """The instrument's own clock."""
    return round(t * 1e3) % (1 << 31) if t < inf else 0
