"""What a station keeps of what it was told, and gives back on demand."""

from fakes.geocom.codes import IVPARAM, OK, Answer, RequestCode, told
from fakes.world.tracker.tracker import Tracker

# Constants that come with a prism type, m: what the maker's manuals list for them.
PRISM_CONSTANTS = {
    0: 0.0, 1: 0.0175, 2: 0.0344, 3: 0.0231, 4: 0.0, 5: 0.0, 6: 0.0, 7: 0.0300, 8: 0.0, 9: 0.0, 10: 0.0344,
    11: 0.0231,
}  # fmt: skip
_WAVELENGTH_M = 658e-9
_PA_PER_MBAR = 100.0
_LARGEST_CONSTANT_M = 0.2


class Settings:
    """As they are after switching on; the reflector constant is the tracker's own."""

    def __init__(self, tracker: Tracker) -> None:
        truth, self._tracker = tracker.truth, tracker
        self.digits, self.edm_mode, self.prism_type = 15, 2, 0
        self.atr = self.lock = False
        self.compensator = True
        self.reflector_height = 0.0
        self.station = (0.0, 0.0, 0.0, 0.0)  # E, N, H, instrument height, m
        # Wavelength (m), pressure (mbar), dry and wet temperature (deg C).
        self.air = (
            _WAVELENGTH_M,
            truth.pressure_pa / _PA_PER_MBAR,
            truth.temperature_c,
            truth.temperature_c,
        )

    def procedures(self) -> dict[int, RequestCode]:
        """Those that only write and read."""
        p = RequestCode
        return {
            107: p(1, lambda a: self._set("digits", int(a[0]), 0 <= a[0] <= 15)),
            108: told(lambda: self.digits),
            2006: p(1, lambda a: self._set("compensator", bool(a[0]))),
            2007: told(lambda: self.compensator),
            2009: told(lambda: self.station),
            2010: p(4, lambda a: self._set("station", a)),
            2011: told(lambda: self.reflector_height),
            2012: p(1, lambda a: self._set("reflector_height", a[0])),
            2020: p(1, lambda a: self._set("edm_mode", int(a[0]), 0 <= a[0] <= 20)),
            2021: told(lambda: self.edm_mode),
            2023: told(lambda: self._tracker.constant_m),
            2024: p(1, lambda a: self._set_constant(a[0])),
            2028: p(4, lambda a: self._set("air", a, 500.0 <= a[1] <= 1200.0)),
            2029: told(lambda: self.air),
            17008: p(1, lambda a: self._set_prism(int(a[0]))),
            17009: told(lambda: self.prism_type),
        }

    def _set(self, name: str, value: object, valid: bool = True) -> Answer:
        if not valid:
            return IVPARAM, ()
        setattr(self, name, value)
        return OK, ()

    def _set_constant(self, metres: float) -> Answer:
        if abs(metres) > _LARGEST_CONSTANT_M:
            return IVPARAM, ()
        self._tracker.constant_m = metres
        return OK, ()

    def _set_prism(self, number: int) -> Answer:
        """The constant comes with the type."""
        if number not in PRISM_CONSTANTS:
            return IVPARAM, ()
        self._tracker.constant_m = PRISM_CONSTANTS[number]
        return self._set("prism_type", number)
