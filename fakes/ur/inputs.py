"""What RTDE clients write: registers, outputs behind masks, the speed slider; and the watchdog over them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

Written = Mapping[str, float | tuple[float, ...]]

_BANKS = {
    "standard_digital_output": (0, 8),
    "configurable_digital_output": (8, 8),
    "tool_digital_output": (16, 2),
}
_BIT_WORDS = {"input_bit_registers0_to_31": 0, "input_bit_registers32_to_63": 32}


@dataclass
class InputOutput:
    """Digital and analogue I/O. Bits 0-7 standard, 8-15 configurable, 16-17 tool."""

    digital_in: int = 0
    digital_out: int = 0
    analog_out: list[float] = field(default_factory=lambda: [0.0, 0.0])
    speed_fraction: float = 1.0
    listeners: list[Callable[[int], None]] = field(default_factory=list)  # of the digital outputs

    def write_digital(self, shift: int, mask: int, value: int) -> None:
        """Set the outputs of one bank that ``mask`` names."""
        before = self.digital_out
        self.digital_out = (before & ~(mask << shift)) | ((value & mask) << shift)
        if self.digital_out != before:
            for listener in tuple(self.listeners):
                listener(self.digital_out)


@dataclass
class Watchdog:
    """A minimum rate for one input; expired once it is late."""

    name: str
    period: float
    last: float


class Inputs:
    """Takes input packages apart."""

    def __init__(self, registers: dict[str, float], io: InputOutput) -> None:
        self._registers, self._io = registers, io
        self.vectors: dict[str, tuple[float, ...]] = {}
        self._watchdog: Watchdog | None = None

    def write(self, values: Written, t: float) -> None:
        """One input package that arrived at ``t``."""
        for name, value in values.items():
            if isinstance(value, tuple):
                self.vectors[name] = value
            elif name in _BIT_WORDS:
                self._write_bits(_BIT_WORDS[name], int(value))
            elif name.startswith("input_"):
                self._registers[name] = value
        for bank, (shift, width) in _BANKS.items():
            mask = int(_scalar(values, f"{bank}_mask")) & ((1 << width) - 1)
            self._io.write_digital(shift, mask, int(_scalar(values, bank)))
        self._write_analog(values)
        if self._watchdog is not None and self._watchdog.name in values:
            self._watchdog.last = t

    def arm_watchdog(self, name: str, frequency: float, t: float) -> None:
        """Watch ``name`` from ``t`` on; a frequency of zero watches nothing."""
        self._watchdog = Watchdog(name, 1.0 / frequency, t) if frequency > 0 else None

    def disarm_watchdog(self) -> None:
        """Watchdogs belong to the program that set them."""
        self._watchdog = None

    def excuse(self, seconds: float, t: float) -> None:
        """The twin stood still for so long, until ``t``: what clients wrote meanwhile may not have been read
        yet. A controller, which has a computer of its own, would have read it."""
        if self._watchdog is not None:  # what has been read since then is no later than now
            self._watchdog.last = min(self._watchdog.last + seconds, t)

    def watchdog_expired(self, t: float) -> bool:
        """True when the watched input is late."""
        return self._watchdog is not None and t - self._watchdog.last > self._watchdog.period

    def _write_bits(self, first: int, word: int) -> None:
        for k in range(32):
            self._registers[f"input_bit_register_{first + k}"] = word >> k & 1

    def _write_analog(self, values: Written) -> None:
        mask = int(_scalar(values, "standard_analog_output_mask"))
        for k in (0, 1):
            if mask >> k & 1:
                self._io.analog_out[k] = _scalar(values, f"standard_analog_output_{k}")
        if _scalar(values, "speed_slider_mask"):
            self._io.speed_fraction = min(max(_scalar(values, "speed_slider_fraction"), 0.0), 1.0)


def _scalar(values: Written, name: str) -> float:
    value = values.get(name, 0.0)
    return 0.0 if isinstance(value, Sequence) else value
