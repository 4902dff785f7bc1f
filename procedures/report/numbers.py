"""Numbers as people read them, read tolerantly from data that may be incomplete."""

import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from cell.poses import Array, from_pose6

DASH = "–"
_MM, _DEG = 1e3, 180.0 / math.pi
_LARGEST = 1e6  # m^2 and rad^2: beyond it nothing is known, and squares of it overflow
K95 = 1.96  # standard deviations to 95 % of one component of a normal distribution


def dig(value: Any, *keys: str) -> Any:
    """``value[key][key]...``, None where something on the way is missing or is no mapping."""
    for key in keys:
        if not isinstance(value, Mapping):
            return None
        value = value.get(key)
    return value


def number(value: Any) -> float | None:
    """A finite number, else None."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return None
    return float(value)


def mm(value: Any) -> str:
    """Metres as millimetres; three decimals, one more for what would vanish."""
    return _scaled(value, _MM, 3, " mm")


def deg(value: Any) -> str:
    """Radians as degrees; four decimals, one more for what would vanish."""
    return _scaled(value, _DEG, 4, "°")


def mms(values: Iterable[float]) -> list[str]:
    """Metres as millimetres for a row of a table: without unit, and with decimals alike."""
    return [_fixed(value * _MM, 3) for value in values]


def degs(values: Iterable[float]) -> list[str]:
    """Radians as degrees for a row of a table: without unit, and with decimals alike."""
    return [_fixed(value * _DEG, 4) for value in values]


def px(value: Any) -> str:
    return _scaled(value, 1.0, 3, " px")


def _scaled(value: Any, scale: float, decimals: int, unit: str) -> str:
    plain = number(value)
    if plain is None:
        return DASH
    shown = plain * scale
    if 0.0 < abs(shown) < 10.0 * 10.0**-decimals:
        decimals += 1
    return _fixed(shown, decimals) + unit


def _fixed(value: float, decimals: int) -> str:
    """With a true minus sign, and never a negative zero."""
    shown = f"{value:.{decimals}f}"
    return shown.lstrip("-") if float(shown) == 0.0 else shown.replace("-", "\N{MINUS SIGN}")


def matrix4(pose: Any) -> Array | None:
    """(4, 4) of ``[x, y, z, rx, ry, rz]``, None for anything else."""
    if not isinstance(pose, list) or len(pose) != 6 or any(number(v) is None for v in pose):
        return None
    return np.asarray(from_pose6(pose).as_matrix(), dtype=float)


def covariance(value: Any) -> Array | None:
    """A finite (6, 6) array of m^2 and rad^2, None for anything else."""
    try:
        cov = np.array(value, dtype=float)
    except (TypeError, ValueError):
        return None
    return cov if cov.shape == (6, 6) and bool(np.all(np.abs(cov) < _LARGEST)) else None
