"""How a station tells angles, distances and coordinates."""

from collections.abc import Callable

from fakes.geocom.aiming import Aiming
from fakes.geocom.codes import (
    DISTANCE_ERROR,
    DOUBT,
    IVPARAM,
    NO_DISTANCE,
    OK,
    Answer,
    Parameters,
    RequestCode,
)
from fakes.geocom.edm import CLEAR, DISTANCE, PROGRAMS, RAPID_TRACK, STOP, Edm
from fakes.geocom.settings import Settings
from fakes.world.tracker.tracker import Reading, Tracker

_QUICK_S, _LONGEST_WAIT_S = 2.0, 60.0
_ANGLE_ACCURACY_RAD = 2.4e-6


class Measuring:
    """Procedures that read ``tracker``; angles without a distance come with return code 1285 or 1292."""

    def __init__(
        self, tracker: Tracker, edm: Edm, settings: Settings, aiming: Aiming, now: Callable[[], float]
    ) -> None:
        self._tracker, self._edm, self._settings = tracker, edm, settings
        self._aiming, self._now = aiming, now

    def procedures(self) -> dict[int, RequestCode]:
        p = RequestCode
        return {
            2008: p(2, self._do_measure),
            2082: p(2, self._coordinate),
            2107: p(1, lambda a: (OK, self._aim())),
            2108: p(2, self._simple),
            2116: p(2, self._simple_coordinate),
            2117: p(0, self._quick),
            2167: p(2, self._full),
            17017: p(1, self._measure_distance_angle),
        }

    def _do_measure(self, a: Parameters) -> Answer:
        if int(a[0]) not in PROGRAMS:
            return IVPARAM, ()
        self._edm.start(int(a[0]))
        return OK, ()

    async def _full(self, a: Parameters) -> Answer:
        code, reading, (hz, v) = await self._measured(a[0])
        slope, stamp = (0.0, 0) if reading is None else (reading.slope, _ms(reading.t))
        return code, (hz, v, _ANGLE_ACCURACY_RAD, 0.0, 0.0, 0.0, slope, float(stamp))

    async def _simple(self, a: Parameters) -> Answer:
        code, reading, (hz, v) = await self._measured(a[0])
        return code, (hz, v, 0.0 if reading is None else reading.slope)

    async def _coordinate(self, a: Parameters) -> Answer:
        code, reading, _ = await self._measured(a[0])
        place, stamp = self._place(reading), 0 if reading is None else _ms(reading.t)
        return code, (*place, stamp, *place, stamp)

    async def _simple_coordinate(self, a: Parameters) -> Answer:
        code, reading, _ = await self._measured(a[0])
        return code, self._place(reading)

    async def _quick(self, a: Parameters) -> Answer:
        if not self._edm.tracks:
            self._edm.start(RAPID_TRACK)
        return await self._simple((1e3 * _QUICK_S, 0.0))

    async def _measure_distance_angle(self, a: Parameters) -> Answer:
        """Whole measurements: 0 the last one, 1 angles, 2 a distance, 3 and 4 track, 5 clear, 6 stop."""
        mode = int(a[0])
        if mode not in range(7):
            return IVPARAM, ()
        if mode in (5, 6):
            self._edm.start(CLEAR if mode == 5 else STOP)
        if mode in (1, 5, 6):
            return OK, (*self._aim(), 0.0, mode)
        if mode == 2:
            if self._settings.atr and self._tracker.read(self._now()).point is None:
                code, _ = await self._aiming.fine_adjust()
                if code != OK:
                    return code, (*self._aim(), 0.0, mode)
            self._edm.start(DISTANCE)
        elif mode in (3, 4) and not self._edm.tracks:
            self._edm.start(RAPID_TRACK)
        code, values = await self._simple((0.0 if mode == 0 else 1e3 * _QUICK_S, 0.0))
        return code, (*values, mode)

    async def _measured(self, wait_ms: float) -> tuple[int, Reading | None, tuple[float, float]]:
        """Return code, the distance if there is one, and the angles that go with it."""
        reading = await self._edm.wait(min(max(wait_ms / 1e3, 0.0), _LONGEST_WAIT_S))
        if reading is None:
            return NO_DISTANCE, None, self._aim()
        if reading.point is None:
            return DISTANCE_ERROR, None, self._aim()
        return (DOUBT if reading.doubtful else OK), reading, (reading.hz, reading.v)

    def _aim(self) -> tuple[float, float]:
        return self._tracker.aim(self._now())

    def _place(self, reading: Reading | None) -> tuple[float, float, float]:
        """Easting, northing and height of a point; the station has its own."""
        if reading is None or reading.point is None:
            return 0.0, 0.0, 0.0
        e, n, h, height = self._settings.station
        x, y, z = reading.point.tolist()
        return e + x, n + y, h + height + z - self._settings.reflector_height


def _ms(t: float) -> int:
    """The instrument's own clock."""
    return round(t * 1e3) % (1 << 31)
