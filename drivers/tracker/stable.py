"""When readings of a point are still enough for their mean to count."""

from collections import deque
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from cell.errors import CellError, error
from cell.laser_tracker import StablePoint
from cell.poses import Array
from cell.samples import Sample


class _Reading(NamedTuple):
    begin: float
    end: float
    point: Array
    warning: str
    rotation: Array | None


class StableWindow:
    """The newest readings, as many as ``window_s`` and ``min_readings`` need; fed until they agree."""

    def __init__(self, window_s: float, max_scatter_m: float, min_readings: int) -> None:
        self._window_s, self._max_scatter_m, self._least = window_s, max_scatter_m, min_readings
        self._readings: deque[_Reading] = deque()
        self._total = 0
        self._scatter_m: float | None = None

    @property
    def count(self) -> int:
        """Readings since the last :meth:`restart`."""
        return len(self._readings)

    def restart(self) -> None:
        """There is a hole in the readings: a mean across it would mix two stands."""
        self._readings.clear()

    def add(
        self, t: float, dt: float, point: Array, warning: str = "", rotation: Array | None = None
    ) -> bool:
        """One more reading; True when the window is full and its scatter within the limit."""
        self._total += 1
        self._readings.append(_Reading(t - dt, t + dt, point, warning, rotation))
        while len(self._readings) > self._least and self._full(from_index=1):
            self._readings.popleft()
        if len(self._readings) < self._least or not self._full():
            return False
        self._scatter_m = self._scatter()
        return self._scatter_m <= self._max_scatter_m

    def sample(self, seq: int, temperature_c: float | None, pressure_pa: float | None) -> Sample[StablePoint]:
        """The mean, once :meth:`add` was true."""
        begin, end = self._readings[0].begin, self._readings[-1].end
        warnings = dict.fromkeys(r.warning for r in self._readings if r.warning)
        point = StablePoint(
            np.mean([r.point for r in self._readings], axis=0),
            self._scatter(),
            len(self._readings),
            end - begin,
            temperature_c,
            pressure_pa,
            tuple(warnings),
            rotation=self._rotation(),
        )
        return Sample(point, 0.5 * (begin + end), 0.5 * (end - begin), seq)

    def unstable(self, name: str, timeout: float) -> CellError:
        """``TRACKER_UNSTABLE`` that says what was seen in ``timeout`` s."""
        seen = f"{self._total} readings"
        if self._scatter_m is None:
            lack = f"{self._least} in a row over {self._window_s:g} s are needed; allow more time"
            return error("TRACKER_UNSTABLE", f"{name} gave {seen} in {timeout:g} s; {lack}")
        return error(
            "TRACKER_UNSTABLE",
            f"{name} gave {seen} in {timeout:g} s, and the last {self.count} scatter by"
            f" {1e3 * self._scatter_m:.3f} mm RMS; the limit is {1e3 * self._max_scatter_m:.3f} mm",
        )

    def _full(self, from_index: int = 0) -> bool:
        return self._readings[-1].end - self._readings[from_index].begin >= self._window_s

    def _rotation(self) -> Array | None:
        """The mean, where every reading has one."""
        turns = [r.rotation for r in self._readings]
        if any(turn is None for turn in turns):
            return None
        return np.asarray(Rotation.from_rotvec(np.array(turns)).mean().as_rotvec())

    def _scatter(self) -> float:
        points = np.array([r.point for r in self._readings])
        return float(np.sqrt(np.mean(np.sum((points - points.mean(axis=0)) ** 2, axis=1))))
