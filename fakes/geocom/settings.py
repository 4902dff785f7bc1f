"""What a station keeps of what it was told, and gives back on demand."""

from dataclasses import dataclass, field

# Constants that come with a prism type, m: what the maker's manuals list for them.
PRISM_CONSTANTS = {
    0: 0.0, 1: 0.0175, 2: 0.0344, 3: 0.0231, 4: 0.0, 5: 0.0, 6: 0.0, 7: 0.0300, 8: 0.0, 9: 0.0, 10: 0.0344,
    11: 0.0231,
}  # fmt: skip
INSTRUMENTS_WAVELENGTH_M = 658e-9


@dataclass
class Settings:
    """Everything but the reflector constant, which is the tracker's own."""

    digits: int = 15
    edm_mode: int = 2
    prism_type: int = 0
    atr: bool = False
    lock: bool = False
    compensator: bool = True
    reflector_height: float = 0.0
    station: list[float] = field(default_factory=lambda: [0.0] * 4)  # E, N, H, instrument height
    air: list[float] = field(default_factory=list)  # wavelength, mbar, dry and wet temperature
