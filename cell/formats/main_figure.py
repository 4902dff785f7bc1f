"""The one figure by which a list of runs tells what a result came to."""

from dataclasses import dataclass
from math import degrees, floor, isfinite, log10
from typing import Any

SHOWN = {"m": (1e3, "mm"), "rad": (degrees(1.0), "°"), "s": (1e3, "ms")}  # for people's eyes
MOST_DECIMALS, USUAL_DECIMALS = 7, 3


@dataclass(frozen=True)
class MainFigure:
    """``name`` is the key in the result and ``words`` say it; ``value`` in ``unit`` (SI, empty for a count).

    ``uncertainty``: 95 % of its errors stay below this, same unit; None where the figure itself is a bound.
    """

    name: str
    words: str
    value: float
    unit: str
    uncertainty: float | None = None

    def text(self) -> str:
        """Value and uncertainty with the unit of people, as precise as it is known."""
        if not self.unit:
            return f"{self.value:g}"
        scale, symbol = SHOWN.get(self.unit, (1.0, self.unit))
        shown, half = scale * self.value, None if self.uncertainty is None else scale * self.uncertainty
        decimals = _decimals(half)
        value = f"{shown:.{decimals}f}"
        return f"{value} {symbol}" if half is None else f"{value} ± {half:.{decimals}f} {symbol}"


def read_main_figure(stored: Any) -> MainFigure | None:
    """As ``end.json`` has it; None for anything else."""
    match stored:
        case {"name": str(name), "words": str(words), "unit": str(unit), "value": int() | float() as value}:
            half = stored.get("uncertainty")
            if _is_number(value) and (half is None or _is_number(half)):
                return MainFigure(name, words, value, unit, half)
    return None


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and isfinite(value)


def _decimals(half: float | None) -> int:
    """Two digits of the uncertainty, in the unit that is shown."""
    if not half or not isfinite(half):
        return USUAL_DECIMALS
    return max(0, min(MOST_DECIMALS, 1 - floor(log10(abs(half)))))
