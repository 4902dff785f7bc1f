"""What the belt does next: the fitted motion, carried on, and how far that can be trusted."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from calibration.belt.clock import Timed
from calibration.belt.fit import Judge, Window
from calibration.belt.ripple import Ripple
from cell.poses import Array

_UNKNOWN = 0.02  # of the speed: what a belt does that has not been watched yet
_PERSISTS = 0.1  # s; belts do not change their acceleration sooner
_COMPARABLE = 0.5  # of the time that this forecast rests on; others rest on too little to compare
_HIDDEN = 0.02  # s in which a change does not show
_NORMAL95, _RARE = 1.96, -np.log(0.95)
_FEW = 4  # past forecasts that say something
_QUANTUM = 12.0**-0.5
_TURNED = 3.0  # counts; a fit may pass each reading by one, on either side


@dataclass(frozen=True)
class Motion:
    """A motion fitted to the counts up to ``now`` (stamp of the newest, s); positions in counts.

    ``timed`` holds the true times of the frames from ``begin`` on. A parabola is followed for as long as it
    has been seen and not beyond the speeds ``low`` and ``high`` (counts/s), then the speed stays. One that
    would turn the belt as it never went stays at rest until the counts go back as well: a belt that was
    braked to a stop.
    """

    now: float
    timed: Timed
    begin: int
    fit: Window | Ripple
    judge: Judge
    low: float
    high: float

    @property
    def name(self) -> str:
        """``line``, ``bend`` or ``ripple``."""
        if isinstance(self.fit, Ripple):
            return "ripple"
        return ("line", "bend")[self.fit.order - 1]

    def covers(self, t: Array) -> NDArray[np.bool_]:
        """Which of ``t`` are inside the window of the fit, or later."""
        return np.asarray(self.fit.ok & (t >= self.now - self.fit.length))

    def covers_at(self, t: float) -> bool:
        """Whether one ``t`` is."""
        return self.fit.ok and t >= self.now - self.fit.length

    def position(self, t: Array) -> Array:
        """Counts at ``t`` (k,)."""
        s = np.asarray(t, dtype=float) - self.now
        if isinstance(self.fit, Ripple):
            return self.fit.position(s)
        c0, c1, c2, until, end = self._course
        x = np.minimum(s, until)
        return np.asarray(c0 + x * (c1 + c2 * x) + (s - x) * end)

    def position_at(self, t: float) -> float:
        """Counts at one ``t``, in plain numbers: they are asked for one by one all the time."""
        s = t - self.now
        if isinstance(self.fit, Ripple):
            return self.fit.position_at(s)
        c0, c1, c2, until, end = self._course
        x = min(s, until)
        return c0 + x * (c1 + c2 * x) + (s - x) * end

    def speed_at(self, t: float) -> float:
        """Counts per second at ``t``."""
        s = t - self.now
        if isinstance(self.fit, Ripple):
            return self.fit.speed_at(s)
        _, c1, c2, until, _ = self._course
        return c1 + 2.0 * c2 * min(s, until)

    @cached_property
    def _course(self) -> tuple[float, float, float, float, float]:
        """Of a line or a parabola: its coefficients, until when it bends (s), and the speed from then on."""
        c0, c1, *more = self.fit.c.tolist()
        if isinstance(self.fit, Ripple) or not more:
            return c0, c1, 0.0, np.inf, c1
        until = self._bends_for(self.fit)
        return c0, c1, more[0], until, c1 + 2.0 * more[0] * until

    def _bends_for(self, fit: Window) -> float:
        _, v, half = fit.c.tolist()
        bound = self.high if half > 0.0 else self.low
        if np.isinf(bound) and v * half > 0.0 and v * v < 4.0 * abs(half) * _TURNED:
            return float(max(-v / (2.0 * half), -fit.length - _HIDDEN))
        reach = (bound - v) / (2.0 * half) if abs(half) > 1e-9 else np.inf
        return float(min(max(reach, 0.0), max(fit.length, _PERSISTS)))

    def variance(self, a: float, b: float) -> float:
        """Of the travel from ``a`` to ``b``, counts squared, if the motion goes on as fitted."""
        g = self._gradient(b) - self._gradient(a)
        return float(g @ self.fit.cov @ g)

    def _gradient(self, t: float) -> Array:
        s = t - self.now
        if isinstance(self.fit, Ripple):
            return np.asarray(self.fit.gradient(np.array([s]))[0])
        return np.array([s**p for p in range(len(self.fit.c))])


@dataclass(frozen=True)
class Changes:
    """How often (per second) the belt has lately begun or ended to change its speed, how hard (m/s^2), and
    the ``span`` (m/s) from its slowest speed to its fastest."""

    rate: float
    acceleration: float
    span: float

    def variance(self, ahead: float) -> float:
        """Of the travel over ``ahead`` seconds by a change that is not seen yet or comes meanwhile, m^2.

        The mean square would do if errors were normal. They are not: mostly there is no change, and then a
        large one, so the variance is also such that 1.96 standard deviations hold 95 % of them.
        """
        if self.rate <= 0.0:
            return 0.0
        u = ahead + _HIDDEN
        mean_square = min(self.rate * u, 1.0) * self._moved(u) ** 2 / 5.0  # begins at any time, all alike
        surely = max(u - _RARE / self.rate, 0.0)  # has gone on for less, in 95 of 100 cases
        return float(max(mean_square, (self._moved(surely) / _NORMAL95) ** 2))

    def _moved(self, u: float) -> float:
        """How far from where it would be a change takes the belt in ``u`` seconds, m."""
        reach = min(u, self.span / self.acceleration)
        return self.acceleration * reach * (u - 0.5 * reach)


NEVER = Changes(0.0, 0.0, 0.0)


class TravelForecast:
    """The travel of the belt before and after ``now``; metres along the belt, seconds.

    ``past()`` are earlier motions, oldest first: how well they predicted what the counts then showed is the
    error that no covariance knows of (a belt that stops).
    """

    def __init__(
        self,
        m_per_count: float,
        motion: Motion,
        around: Callable[[Array], tuple[Array, Array]],
        past: Callable[[], Sequence[Motion]],
        changes: Changes,
    ) -> None:
        self.m_per_count, self.motion = m_per_count, motion
        self._around, self._past, self._changes = around, past, changes
        self._errors: dict[float, float | None] = {}

    @property
    def now(self) -> float:
        """Stamp of the newest count."""
        return self.motion.now

    def travel(self, t: float) -> float:
        """Travel since the first count, m."""
        if t > self.now or self.motion.covers_at(t):
            return self.motion.position_at(t) * self.m_per_count
        return float(self._around(np.array([t]))[0][0]) * self.m_per_count

    def travelled(self, t: Array) -> Array:
        """Travel since the first count at any times (k,), m."""
        known = (t > self.now) | self.motion.covers(t)
        if known.all():
            return self.travels(t)
        counts = np.empty(len(t))
        counts[known] = self.motion.position(t[known])
        counts[~known] = self._around(t[~known])[0]
        return counts * self.m_per_count

    def travels(self, t: Array) -> Array:
        """Travel at later times (k,), m."""
        return self.motion.position(t) * self.m_per_count

    def travels_at(self, t: float) -> float:
        """Travel at one later time, m."""
        return self.motion.position_at(t) * self.m_per_count

    def speed(self, t: float) -> float:
        """Speed at ``t``, m/s; not meant for times before the fit's window."""
        return self.motion.speed_at(t) * self.m_per_count

    def sigma(self, a: float, b: float) -> float:
        """Standard deviation of the travel from ``a`` to ``b``, m."""
        if a > self.now or self.motion.covers_at(a):
            variance = self.motion.variance(a, b)
        else:
            variance = (
                self.motion.variance(self.now, b)
                + float(self._around(np.array([a]))[1][0]) ** 2
                + _QUANTUM**2
            )
        ahead = b - self.now
        if ahead > 0.0:
            unforeseen = max(self.past_error(ahead) ** 2, self._changes.variance(ahead))
            variance += unforeseen / self.m_per_count**2
        return float(np.sqrt(variance)) * abs(self.m_per_count)

    def past_error(self, ahead: float) -> float:
        """RMS error of the last comparable forecasts over ``ahead`` seconds, m; a guess without any.

        Those of a motion of the same name, where there are enough: a belt that bends is predicted worse.
        """
        key = round(ahead, 3)
        if key not in self._errors:
            self._errors[key] = self._measured(key)
        measured = self._errors[key]
        if measured is None:
            return _UNKNOWN * abs(self.speed(self.now)) * ahead
        return measured

    def _measured(self, ahead: float) -> float | None:
        known = _COMPARABLE * self.motion.fit.length
        past = [m for m in self._past() if m.now + ahead <= self.now and m.fit.length >= known]
        alike = [m for m in past if m.name == self.motion.name]
        past = alike if len(alike) >= _FEW else past
        if len(past) < _FEW:
            return None
        at = np.array([m.now + ahead for m in past])
        then, doubt = self._around(at)
        predicted = np.array([m.position_at(t) for m, t in zip(past, at.tolist(), strict=True)])
        off = np.maximum((predicted - then) ** 2 - doubt**2, 0.0)
        return float(np.sqrt(np.mean(off))) * abs(self.m_per_count)
