"""What we ask of a total station, call by call; every setting is read back."""

import math
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from cell.clock import Clock
from cell.devices import Identity
from cell.errors import CellError, error
from cell.poses import Array
from drivers.tracker.frames import from_station, to_station
from drivers.tracker.geocom_codes import Meaning, ReturnCode
from drivers.tracker.geocom_config import GeocomConfig, ReflectorConfig
from drivers.tracker.geocom_session import GeocomAnswer, GeocomSession
from drivers.tracker.geocom_text import Parameter

_DIGITS = 15
_PA_PER_MBAR = 100.0
_BUSY_PAUSE_S = 0.1
_SHORTEST_S = 0.01
_LOOK_S = 1.0  # a distance is waited for in spells, so that a lost answer costs one of them and not the point
_NO_DISTANCE_YET = 1285
_CONSTANT_TOLERANCE_M = 1e-6
_INCLINATION = {"measure": 0, "auto": 1, "model": 2}
_TRACKING = {"standard": 2, "rapid": 8}
NO_POINT = (Meaning.NO_DISTANCE, Meaning.NO_TARGET)


class Rpc(IntEnum):
    """Procedures by the names of the makers' manuals."""

    COM_NullProc = 0
    COM_SetDoublePrecision = 107
    COM_GetDoublePrecision = 108
    COM_GetSWVersion = 110
    TMC_GetAngle5 = 2107
    TMC_DoMeasure = 2008
    TMC_GetStation = 2009
    TMC_GetHeight = 2011
    TMC_SetEdmMode = 2020
    TMC_GetEdmMode = 2021
    TMC_GetPrismCorr = 2023
    TMC_SetPrismCorr = 2024
    TMC_SetAtmCorr = 2028
    TMC_GetAtmCorr = 2029
    TMC_GetCoordinate = 2082
    TMC_GetSimpleMea = 2108
    TMC_GetFullMeas = 2167
    CSV_GetInstrumentNo = 5003
    CSV_GetInstrumentName = 5004
    CSV_GetSWVersion = 5034
    MOT_ReadLockStatus = 6021
    AUT_LockIn = 9013
    AUT_SetATRStatus = 9018
    AUT_GetATRStatus = 9019
    AUT_SetLockStatus = 9020
    AUT_GetLockStatus = 9021
    AUT_MakePositioning = 9027
    AUT_FineAdjust = 9037
    BAP_SetPrismType = 17008
    BAP_GetPrismType = 17009


@dataclass(frozen=True)
class Reading:
    """One answer about where the reflector is; ``point`` is None without a distance."""

    t: float
    dt: float
    point: Array | None
    code: ReturnCode
    distance_time: float | None = None  # instrument's own clock, ms: tells a new distance from an old one

    @property
    def warning(self) -> str:
        return "" if self.code.meaning is Meaning.OK else str(self.code)


class Station:
    """Calls of one session. ``NoAnswer`` passes through; what the instrument refuses is a coded error."""

    def __init__(self, name: str, config: GeocomConfig, session: GeocomSession, clock: Clock) -> None:
        self._name, self._config, self._session, self._clock = name, config, session, clock
        self._inclination = _INCLINATION[config.inclination]
        self._axis = np.zeros(3)  # of the instrument in its own coordinates, for 'coordinates'
        self._tells_lock = True

    async def call(
        self,
        rpc: Rpc,
        *parameters: Parameter,
        timeout: float | None = None,
        motion: bool = False,
        numbers: int = 0,
    ) -> GeocomAnswer:
        """A call that succeeded, with a warning perhaps; one that finds it busy is repeated."""
        answer = await self._ask(rpc, *parameters, timeout=timeout, motion=motion, numbers=numbers)
        if not answer.code.has_data:
            raise answer.code.as_error(f"{self._name}: {rpc.name}")
        return answer

    async def _ask(
        self,
        rpc: Rpc,
        *parameters: Parameter,
        timeout: float | None = None,
        motion: bool = False,
        numbers: int = 0,
    ) -> GeocomAnswer:
        deadline = self._clock.now() + (timeout or self._config.timeout_s)
        tries = 1 if motion else self._config.lost_after_failures
        while True:
            left = max(deadline - self._clock.now(), _SHORTEST_S)
            answer = await self._session.ask(
                rpc, *parameters, timeout=left, tries=tries, abort=motion, numbers=numbers
            )
            if answer.code.meaning is not Meaning.BUSY or self._clock.now() + _BUSY_PAUSE_S >= deadline:
                return answer
            await self._clock.sleep(_BUSY_PAUSE_S)

    # -- who it is, and how it is set up

    async def wake(self) -> None:
        """Call it until it answers, and ask for all decimals."""
        await self.call(Rpc.COM_NullProc)
        await self._write(Rpc.COM_SetDoublePrecision, Rpc.COM_GetDoublePrecision, _DIGITS)

    async def identify(self) -> Identity:
        """Model, serial number and versions; a twin's serial begins with 9999."""
        serial = (await self.call(Rpc.CSV_GetInstrumentNo)).reply.text()
        model = (await self.call(Rpc.CSV_GetInstrumentName)).reply.text()
        geocom = ".".join((await self.call(Rpc.COM_GetSWVersion)).reply.values)
        firmware = await self._ask(Rpc.CSV_GetSWVersion)
        known = firmware.code.has_data and firmware.reply.values
        version = ".".join(firmware.reply.values) if known else ""
        return Identity(model, serial, version or f"GeoCOM {geocom}", {"geocom": geocom})

    async def set_up(self) -> None:
        """Write what the config says; find out what this instrument can tell."""
        config = self._config
        if config.edm_mode is not None:
            await self._write(Rpc.TMC_SetEdmMode, Rpc.TMC_GetEdmMode, config.edm_mode)
        if config.temperature_c is not None and config.pressure_pa is not None:
            await self._set_air(config.temperature_c, config.pressure_pa)
        if config.reading == "coordinates":
            self._axis = await self._station()
        await self.is_locked()

    async def air(self) -> tuple[float | None, float | None]:
        """Temperature (deg C) and pressure (Pa) that distances are corrected with; None where unknown."""
        answer = await self._ask(Rpc.TMC_GetAtmCorr, numbers=4)
        if not answer.code.has_data:
            return None, None
        _, pressure, dry, _ = answer.reply.floats(4)
        return dry, pressure * _PA_PER_MBAR

    async def use(self, reflector: ReflectorConfig) -> None:
        """Set type or constant of the prism, and compare the constant that it then has."""
        if reflector.prism_type is not None:
            await self._write(Rpc.BAP_SetPrismType, Rpc.BAP_GetPrismType, reflector.prism_type)
        else:
            await self.call(Rpc.TMC_SetPrismCorr, reflector.constant_m)
        await self.require(reflector)
        await self.call(Rpc.TMC_DoMeasure, 3, self._inclination)  # clears distances with the old constant

    async def require(self, reflector: ReflectorConfig) -> None:
        """``TRACKER_SETTING`` when distances are not corrected with this reflector's constant."""
        wanted = reflector.constant_m
        found = (await self.call(Rpc.TMC_GetPrismCorr, numbers=1)).reply.floats(1)[0]
        if abs(found - wanted) > _CONSTANT_TOLERANCE_M:
            raise error(
                "TRACKER_SETTING",
                f"{self._name} has the prism constant {1e3 * found:.3f} mm where the config says"
                f" {1e3 * wanted:.3f} mm",
            )

    # -- turning and searching

    async def turn_to(self, point: Array, timeout: float) -> None:
        """Point the telescope at ``point`` (3,), tracker frame; an earlier lock is given up."""
        hz, v, _ = to_station(point)
        await self.call(Rpc.AUT_SetLockStatus, False)
        await self.call(Rpc.AUT_MakePositioning, hz, v, 0, 0, False, timeout=timeout, motion=True)

    async def search(self, timeout: float) -> None:
        """Find the reflector around where the telescope points, and aim at it."""
        window = self._config.search_window_rad
        await self._write(Rpc.AUT_SetATRStatus, Rpc.AUT_GetATRStatus, 1)
        await self.call(Rpc.AUT_FineAdjust, window, window, False, timeout=timeout, motion=True)

    async def lock(self, timeout: float) -> None:
        """Follow the reflector that was found."""
        await self._write(Rpc.AUT_SetLockStatus, Rpc.AUT_GetLockStatus, 1)
        await self.call(Rpc.AUT_LockIn, timeout=timeout, motion=True)

    async def is_locked(self) -> bool | None:
        """Whether it follows a reflector now; None from an instrument that does not tell."""
        if not self._tells_lock:
            return None
        answer = await self._ask(Rpc.MOT_ReadLockStatus, numbers=1)
        if answer.code.has_data:
            return answer.reply.floats(1)[0] == 1
        self._tells_lock = answer.code.meaning is not Meaning.UNKNOWN_CALL
        return None

    # -- distances and angles

    async def start_tracking(self) -> None:
        """Measure distances all the time; those from before are forgotten."""
        await self.call(Rpc.TMC_DoMeasure, 3, self._inclination)
        await self.call(Rpc.TMC_DoMeasure, _TRACKING[self._config.tracking], self._inclination)

    async def single(self, wait_s: float) -> Reading:
        """Measure one distance, begun after the call."""
        begin = self._clock.now()
        await self.call(Rpc.TMC_DoMeasure, 3, self._inclination)
        await self.call(Rpc.TMC_DoMeasure, 1, self._inclination)
        return await self.read(wait_s, begin)

    async def read(self, wait_s: float, begin: float | None = None) -> Reading:
        """The newest distance and the angles; waits up to ``wait_s`` for the first one.

        Whatever return code there is, it is in the reading.
        """
        deadline = self._clock.now() + wait_s
        while True:
            wait = min(max(deadline - self._clock.now(), 0.0), _LOOK_S)
            answer = await self._look(wait)
            waited = answer.end - answer.begin >= 0.5 * wait  # else the instrument knows that none will come
            unfinished = waited and answer.code.number == _NO_DISTANCE_YET
            if not unfinished or self._clock.now() >= deadline:
                break
        begin = answer.begin if begin is None else begin
        t, dt = 0.5 * (begin + answer.end), 0.5 * (answer.end - begin)
        if not answer.code.has_data:
            return Reading(t, dt, None, answer.code)
        point, distance_time = self._decode(answer)
        return Reading(t, dt, point, answer.code, distance_time)

    async def _look(self, wait_s: float) -> GeocomAnswer:
        rpc, numbers = {
            "full": (Rpc.TMC_GetFullMeas, 8),
            "simple": (Rpc.TMC_GetSimpleMea, 3),
            "coordinates": (Rpc.TMC_GetCoordinate, 4),
        }[self._config.reading]
        timeout = wait_s + self._config.timeout_s
        return await self._ask(rpc, round(1e3 * wait_s), self._inclination, timeout=timeout, numbers=numbers)

    async def angles(self) -> Reading:
        """Whether the angles can be read; there is no distance."""
        answer = await self._ask(Rpc.TMC_GetAngle5, self._inclination)
        half = 0.5 * (answer.end - answer.begin)
        return Reading(answer.begin + half, half, None, answer.code)

    def _decode(self, answer: GeocomAnswer) -> tuple[Array, float | None]:
        if self._config.reading == "coordinates":
            e, n, h, time = answer.reply.floats(4)
            return np.array([e, n, h]) - self._axis, time
        if self._config.reading == "simple":
            hz, v, slope = answer.reply.floats(3)
            return from_station(hz, v, slope), None
        hz, v, *_, slope, time = answer.reply.floats(8)
        return from_station(hz, v, slope), time

    async def _station(self) -> Array:
        """Easting, northing, height of where the axes meet, less the reflector's height over its point."""
        e, n, h, instrument_height = (await self.call(Rpc.TMC_GetStation)).reply.floats(4)
        reflector_height = (await self.call(Rpc.TMC_GetHeight)).reply.floats(1)[0]
        return np.array([e, n, h + instrument_height - reflector_height])

    async def _set_air(self, temperature_c: float, pressure_pa: float) -> None:
        wavelength, _, _, wet = (await self.call(Rpc.TMC_GetAtmCorr)).reply.floats(4)
        await self.call(Rpc.TMC_SetAtmCorr, wavelength, pressure_pa / _PA_PER_MBAR, temperature_c, wet)
        dry, pressure = await self.air()
        if not (
            dry is not None
            and pressure is not None
            and math.isclose(dry, temperature_c, abs_tol=0.05)
            and math.isclose(pressure, pressure_pa, abs_tol=50.0)
        ):
            wanted = f"{temperature_c} deg C and {pressure_pa} Pa"
            raise self._not_taken(Rpc.TMC_SetAtmCorr, wanted, f"{dry} deg C and {pressure} Pa")

    async def _write(self, write: Rpc, read: Rpc, value: int) -> None:
        await self.call(write, value)
        found = (await self.call(read)).reply.floats(1)[0]
        if found != value:
            raise self._not_taken(write, value, found)

    def _not_taken(self, rpc: Rpc, wanted: object, found: object) -> CellError:
        return error("TRACKER_SETTING", f"{self._name}: {rpc.name} wrote {wanted}, but it reads back {found}")
