"""Whether a count goes on from the one before, or the encoder counts from elsewhere."""

from collections.abc import Callable, Mapping
from typing import Any

from cell.devices import Encoder, EncoderState
from cell.errors import CellError, error
from cell.samples import Sample

FASTEST_M_S, SPARE_M = 5.0, 0.01  # of any belt; and what time-stamps and the rounding of counts leave open


class CountOrigin:
    """Told of every count of one encoder.

    Where the range wraps it counts on. It counts from elsewhere in a new epoch (its node or link was
    restarted), after its position was set to zero, and after a jump, which is farther than a belt moves at
    ``FASTEST_M_S``. ``belt`` has ``m_per_count``; without it only new epochs are seen.
    """

    def __init__(self, encoder: Encoder, belt: Mapping[str, Any] | None, tell: Callable[..., None]) -> None:
        self._encoder, self._tell = encoder, tell
        self._m_per_count = 0.0 if belt is None else float(belt["m_per_count"])
        self._epoch = encoder.counts.epoch
        self._last: Sample[EncoderState] | None = None
        self.jumps: list[float] = []  # m
        self.changed: CellError | None = None  # why its counts are no longer compared with the first ones

    def moved(self, sample: Sample[EncoderState]) -> bool:
        """Whether ``sample`` counts from elsewhere than the one before it."""
        name, last, epoch = self._encoder.name, self._last, self._encoder.counts.epoch
        anew, self._epoch, self._last = epoch != self._epoch, epoch, sample
        if last is None and not anew:
            return False
        if last is not None and not anew:
            step = (sample.value.count - last.value.count) * self._m_per_count
            most = SPARE_M + FASTEST_M_S * (sample.t - last.t)
            if abs(step) <= most:
                return False
            raw = sample.value.raw
            from_zero = min(raw, self._encoder.modulus - raw)  # a belt that counts down is below it
            if abs(from_zero * self._m_per_count) > most:
                self.jumps.append(step)
                self._tell("encoder jump", by_m=round(step, 4), most_m=round(most, 4))
                self.changed = error(
                    "ENCODER_JUMP",
                    f"{name}: {step:+.3f} m from one count to the next, {most:.3f} m is the most at "
                    f"{FASTEST_M_S:g} m/s",
                )
                return True
        self._tell("counts begin anew", count=sample.value.count)
        self.changed = error("DEVICE_LOST", f"{name} began to count anew")
        return True
