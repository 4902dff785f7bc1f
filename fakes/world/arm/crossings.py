"""When a smooth function of time crosses its thresholds: every crossing, to better than a microsecond.

The functions are gaps (m) that change no faster than a known speed. Two samples whose distances from a
threshold add up to more than the way possible between them enclose no crossing; other intervals are
divided until the way is ``FINE_M``. Then a crossing lies between two samples, or a graze beside the least
one of three, which is looked at through ever smaller windows.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from cell.poses import Array

Gaps = Callable[[Array], Array]  # times (n,) s to gaps (n, b) m
Room = Callable[[Array], Array]  # times (n,) s to room (n,) m, below zero where the state has changed

FINE_M = 3e-6  # a graze on so short a way is no deeper than a nanometre
NOISE_M = 1e-11  # below this a gap is rounding
SHARP_S = 1e-9
_PARTS = 8
_ZOOMS = 4
_MOST_STEPS = 60


@dataclass(frozen=True)
class Mesh:
    """Samples so dense that state can only change in ``open`` intervals: (n,), (n, b) and (n - 1, b)."""

    times: Array
    gaps: Array
    open: np.ndarray


def mesh(gaps: Gaps, times: Array, speed: float, half_band: Array) -> Mesh:
    """Sample between ``times`` (n,) until crossings of ``+-half_band`` (b,) are enclosed in fine intervals.

    ``speed`` (m/s) bounds the change of all gaps between the first and the last time.
    """
    found = gaps(times)
    while True:
        way = speed * np.diff(times)
        is_open = _may_cross(found, half_band, way)
        divide = np.flatnonzero(is_open.any(axis=1) & (way > FINE_M))
        if not len(divide):
            return Mesh(times, found, is_open)
        new = _inside(times[divide], times[divide + 1])
        where = np.repeat(divide + 1, _PARTS - 1)
        times, found = np.insert(times, where, new), np.insert(found, where, gaps(new), axis=0)


def crossings(gap: Room, mesh: Mesh, beam: int, half_band: float, inside: bool) -> list[float]:
    """The times at which column ``beam`` of ``mesh`` changes its state, which is ``inside`` before the first.

    It gets inside where the gap falls below ``-half_band`` and outside where it rises above ``half_band``;
    at a change the gap is beyond its threshold by less than rounding. ``gap`` gives (n,) for times (n,).
    """
    found: list[float] = []
    times, gaps = mesh.times.tolist(), mesh.gaps[:, beam].tolist()
    last = len(times) - 1

    def room(value: Any) -> Any:
        """How far the state is from changing, m."""
        return half_band - value if inside else value + half_band

    def change(a: float, b: float) -> None:
        """The state changes between the times, and is another at ``b``."""
        nonlocal inside
        found.append(_crossing(lambda t: room(gap(t)), max([a, *found[-1:]]), b))
        inside = not inside

    if room(gaps[0]) < -NOISE_M:  # something jumped
        found.append(times[0])
        inside = not inside
    is_open = mesh.open[:, beam]
    near = np.zeros(len(times), dtype=bool)
    near[1:] |= is_open
    near[:-1] |= is_open
    for j in np.flatnonzero(near).tolist():
        if j > 0 and room(gaps[j]) < -NOISE_M:
            change(times[j - 1], times[j])
        elif 0 < j < last and room(gaps[j - 1]) > room(gaps[j]) <= room(gaps[j + 1]):
            beyond = _graze(lambda t: room(gap(t)), times[j - 1], times[j + 1])
            if beyond is not None:
                change(times[j - 1], beyond)
                if room(gaps[j + 1]) < -NOISE_M:
                    change(times[j - 1], times[j + 1])
    return found


def _inside(starts: Array, ends: Array) -> Array:
    """Equally spaced times within intervals, (n * 7,)."""
    inner = np.arange(1, _PARTS) / _PARTS
    out: Array = (starts[:, None] + (ends - starts)[:, None] * inner).ravel()
    return out


def _may_cross(gaps: Array, half_band: Array, way: Array) -> np.ndarray:
    out = np.zeros((len(gaps) - 1, gaps.shape[1]), dtype=bool)
    for threshold in (half_band, -half_band):
        off = np.abs(gaps - threshold)
        out |= off[:-1] + off[1:] <= way[:, None] + NOISE_M
    return out


def _graze(room: Room, a: float, b: float) -> float | None:
    """A time in ``a .. b`` at which ``room`` is below zero, though it is not at either end; or None."""
    for _ in range(_ZOOMS):
        times = np.linspace(a, b, 2 * _PARTS + 1)
        values = room(times)
        k = int(np.argmin(values))
        if values[k] < -NOISE_M:
            return float(times[k])
        a, b = float(times[max(k - 1, 0)]), float(times[min(k + 1, 2 * _PARTS)])
    return None


def _crossing(room: Room, a: float, b: float) -> float:
    """Where ``room`` becomes negative between ``a`` and ``b``, where it is: a little after, never before."""
    times = np.linspace(a, b, _PARTS + 1)
    values = room(times)
    k = int(np.argmax(values < -NOISE_M))
    if k == 0:
        return a
    (low, high), (above, below) = times[k - 1 : k + 1].tolist(), values[k - 1 : k + 1].tolist()
    for step in range(_MOST_STEPS):
        slope = (max(above, 0.0) - below) / (high - low)
        t = low + max(above, 0.0) / slope + 0.2 * SHARP_S
        if step % 3 == 2:  # one end may stay for long
            t = 0.5 * (low + high)
        if not low < t < high:
            break
        value = float(room(np.array([t]))[0])
        if value > 0.0:
            low, above = t, value
        else:
            high, below = t, value
            if -value <= SHARP_S * slope:
                break
    return float(high)
