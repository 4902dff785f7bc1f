"""The belt's travel now, before and later, from encoder counts alone, frame by frame.

Causal by construction: the estimator holds only what :meth:`BeltEstimator.add` has given it, and what it
answers depends on nothing else, neither on earlier questions nor on the time of asking.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache, partial

import numpy as np

from calibration.belt.change_point import kinked
from calibration.belt.clock import FrameCounter, Timed, strays, true_times
from calibration.belt.fit import Judge, Tail, Window, line_and_bend, newest_strays
from calibration.belt.forecast import NEVER, Motion, TravelForecast
from calibration.belt.history import History
from calibration.belt.ripple import Ripple, blocks, refine, search
from calibration.belt.smooth import NEAR, smooth
from calibration.belt.speeds import Speeds
from calibration.belt.unwrap import Unwrapper, fastest_counts
from cell.poses import Array

LONG = 12.0  # s of history that a forecast looks at
_SEARCH_EVERY = 0.25  # s between searches for ripple
_BEND_WORTH = 1.6  # times as long as the line's window, before a parabola is believed
_RIPPLE_WORTH = 1.3
_RIPPLE_SIGMA = 1.5e-3  # m at 0.6 s; ripple that is known worse than this is not extrapolated
_SPEED_EACH = 0.08  # s
_CHANGED = 0.2  # s; the motion is new
_STEADY = 0.25  # s over which the mean speed is taken for that of now, where another one is not believed
_LATELY, _PAUSE = 0.5, 4.0  # s in which a pause of the PC counts, and periods that such a one takes
_SHORT = 0.15  # s; a window so short may be cut by stray frames
_LEARNING = 4  # searches from the start that are no measure of later ones
_ORIGINS = 42  # past forecasts that tell how good forecasts are
_AFTER = 20 * NEAR  # frames after an instant long ago that its window holds
_SHARED = 64  # frames; instants long ago within so many look at one window
_WINDOWS, _SETTLED = 32, 4096  # such windows and instants that are kept at hand


@dataclass(frozen=True)
class EncoderScale:
    """``m_per_count`` (m, signed), ``modulus`` (counts, None: never wraps), ``period`` (s, nominal)."""

    m_per_count: float
    modulus: int | None
    period: float


class BeltEstimator:
    """Counts in, travel out. Times in seconds of one clock, travel in metres along the belt's direction.

    Travel is zero at the first count. Fewer than two counts give no forecast.
    """

    def __init__(self, encoder: EncoderScale) -> None:
        self.encoder = encoder
        self.unwrapper = Unwrapper(encoder.modulus, fastest_counts(encoder.m_per_count))
        self.frames = FrameCounter(encoder.period)
        self.disordered = 0
        self._history = History()
        self._start = 0.0
        self._zero = 0
        self._every = max(8, round(_SEARCH_EVERY / encoder.period))
        self._speed_each = max(4, round(_SPEED_EACH / encoder.period))
        self._motions: dict[int, Motion] = {}
        self._latest: tuple[int, TravelForecast] | None = None
        self._speeds = Speeds()
        # Items are asked about again and again, and what was counted long before does not change.
        self._old_view = lru_cache(_WINDOWS)(self._view_of_old)
        self._settled = lru_cache(_SETTLED)(self._settle)

    def __len__(self) -> int:
        return len(self._history)

    @property
    def newest(self) -> float | None:
        """Stamp of the newest count in use."""
        return self._history.at(len(self) - 1)[0] if len(self) else None

    def extend(self, rows: Iterable[tuple[float, int]]) -> None:
        """Several counts, oldest first."""
        for t, count in rows:
            self.add(t, count)

    def add(self, t: float, count: int) -> None:
        """One count stamped ``t``; stamps must not run backward (such counts are dropped and counted)."""
        history, k = self._history, len(self)
        last = history.at(k - 1) if k else None
        if last is not None and t < last[0]:
            self.disordered += 1
            return
        n = self.unwrapper.add(t, count)
        if n is None:
            return
        if last is None:
            self._start, self._zero = t, n
        if last == (t, n - self._zero):
            return
        history.add(t, n - self._zero, self.frames.add(t, n - self._zero))
        each = self._speed_each
        if (k + 1) % each == 0 and k >= each:
            before = history.at(k - each)
            if t - before[0] > 0.5 * each * self.encoder.period:  # a burst's stamps tell no speed
                self._speeds.add(t, (n - self._zero - before[1]) / (t - before[0]))

    def counts(self, since: float) -> tuple[Array, Array]:
        """Stamps (k,), s, and unwrapped counts (k,) from the last one before ``since`` on."""
        history, size = self._history, len(self)
        begin = max(history.find(since, size) - 1, history.first)
        return history.t(begin, size), history.n(begin, size)

    def forecast(self) -> TravelForecast | None:
        """The travel from here on, with its uncertainty; None with fewer than two counts or no time
        between them.

        What it answers does not change when more counts are added.
        """
        size = len(self)
        if size < 2 or self._history.at(size - 1)[0] <= self._start:
            return None
        if self._latest is None or self._latest[0] != size:
            motion = self._motion(size)
            around, past = partial(self._around, size, motion), partial(self._past, size)
            changes = NEVER  # ripple is none
            if motion.name != "ripple":
                changes = self._speeds.changes(motion.now, self.encoder.m_per_count)
            self._latest = (size, TravelForecast(self.encoder.m_per_count, motion, around, past, changes))
        return self._latest[1]

    def keep_up(self) -> None:
        """Make one of the past forecasts by which a forecast's uncertainty is measured, where one is due.

        Who decides on a loop calls it now and then: all that fell due since the last decision take long.
        """
        due = next((at for at in self._searches(len(self)) if at not in self._motions), None)
        if due is not None:
            self._origin(due)

    def travel_at(self, t: float) -> float | None:
        """Travel at ``t`` from the counts on both sides of it, m; None outside of what was counted."""
        forecast = self.forecast()
        if forecast is None or not self._history.at(self._history.first)[0] <= t <= forecast.now:
            return None
        value, _ = self._around(len(self), forecast.motion, np.array([t]))
        return float(value[0]) * self.encoder.m_per_count

    def _view(self, size: int) -> tuple[int, Timed]:
        """Index of the first frame of the window that ends at frame ``size``, and the times in it."""
        history = self._history
        begin = min(history.find(history.at(size - 1)[0] - LONG, size), size - 2)
        return begin, true_times(history.t(begin, size), history.slots(begin, size), history.n(begin, size))

    def _motion(self, size: int, search_now: bool = False) -> Motion:
        """How the belt moves as the first ``size`` counts show it."""
        begin, timed = self._view(size)
        now = self._history.at(size - 1)[0]
        s, n = timed.t - now, self._history.n(begin, size)
        # Of frames that came at once, to a PC that had stood still, the last one is of that moment.
        alone = np.append(np.diff(s) != 0.0, True)
        s, n = s[alone], n[alone]
        good = ~strays(s, n, timed.sigma)
        s, n = s[good], n[good]
        judge = Judge(timed.sigma, self.encoder.period)
        line, bend = line_and_bend(s, n, judge)
        if max(line.length, bend.length) < _SHORT:
            good = ~newest_strays(s, n, judge)
            s, n = s[good], n[good]
            line, bend = line_and_bend(s, n, judge)
        window = bend if bend.ok and (bend.length > _BEND_WORTH * line.length or not line.ok) else line
        if window.length < _CHANGED:
            # After a pause of the PC counts come in bursts, of which short windows may tell anything.
            low, high = self._speeds.believable(now) if self._paused(timed, now) else (-np.inf, np.inf)
            window = kinked(s, n, judge, self.encoder.m_per_count, (low, high)) or window
            if not low <= window.c[1] <= high:
                window = Tail(s, n, judge).steady(-_STEADY, (high - low) / 8.0)
        ripple = None
        whole = window.ok and window.frames == len(s)
        if not whole:
            ripple = search(s, n, judge) if search_now else self._known_ripple(size, s, n, now, judge)
        if ripple is not None and not self._better(ripple, window):
            ripple = None
        return Motion(
            now, timed, begin, ripple or window, judge, *self._speeds.range(now, float(window.c[1]))
        )

    def _paused(self, timed: Timed, now: float) -> bool:
        """Whether the stamps keep no rhythm, as the PC lately did not take the counts for a while."""
        gaps = np.diff(timed.t[timed.t > now - _LATELY])
        return timed.share is None and bool(np.any(gaps > _PAUSE * self.encoder.period))

    def _better(self, ripple: Ripple, window: Window) -> bool:
        if not ripple.ok or ripple.length < _RIPPLE_WORTH * window.length:
            return False
        g = ripple.gradient(np.array([0.6]))[0]
        return float(np.sqrt(g @ ripple.cov @ g)) * abs(self.encoder.m_per_count) < _RIPPLE_SIGMA

    def _known_ripple(self, size: int, s: Array, n: Array, now: float, judge: Judge) -> Ripple | None:
        """The ripple of the last search, refined with the counts since."""
        at = size - size % self._every
        searched = self._origin(at) if at else None
        if searched is None or not isinstance(searched.fit, Ripple):
            return None
        found = searched.fit
        length = min(found.length + now - searched.now, LONG)
        rows = s >= -length
        ripple, _ = refine(blocks(s[rows], n[rows], judge.period, 0.02), found.f, judge, found.order)
        return ripple if ripple is not None and ripple.ok else None

    def _origin(self, at: int) -> Motion:
        """The motion that frame ``at`` showed, with a search for ripple."""
        if at not in self._motions:
            self._motions[at] = self._motion(at, search_now=True)
            for old in [k for k in self._motions if k < at - 2 * _ORIGINS * self._every]:
                del self._motions[old]
        return self._motions[at]

    def _past(self, size: int) -> list[Motion]:
        """The last motions at the regular searches before frame ``size``, oldest first."""
        return [self._origin(at) for at in self._searches(size)]

    def _searches(self, size: int) -> range:
        """The frames before ``size`` at which it is regularly searched, as far back as they count."""
        last = size - size % self._every
        return range(max(last - _ORIGINS * self._every, _LEARNING * self._every), last + 1, self._every)

    def _around(self, size: int, motion: Motion, t: Array) -> tuple[Array, Array]:
        """Travel (counts) at past ``t`` (k,) from the first ``size`` frames, and its standard deviation."""
        history, begin, times = self._history, motion.begin, motion.timed.t
        old = t < times[min(NEAR, len(times) - 1)]
        if begin <= history.first or not old.any():
            return smooth(times, history.n(begin, begin + len(times)), t)
        value, sigma = np.empty(len(t)), np.empty(len(t))
        if not old.all():
            value[~old], sigma[~old] = self._around(size, motion, t[~old])
        for k in np.flatnonzero(old):
            at = float(t[k])
            after = max(history.find(at, size), history.first) + _AFTER
            end = min(after + -after % _SHARED, size)
            value[k], sigma[k] = self._settled(at, end, history.first)
        return value, sigma

    def _settle(self, t: float, end: int, first: int) -> tuple[float, float]:
        """Travel (counts) at ``t`` long ago and its standard deviation, from the window before ``end``."""
        begin, timed = self._old_view(end, first)
        value, sigma = smooth(timed.t, self._history.n(begin, end), np.array([t]))
        return float(value[0]), float(sigma[0])

    def _view_of_old(self, end: int, first: int) -> tuple[int, Timed]:
        """The window before frame ``end``, while ``first`` is the oldest that is kept."""
        del first
        return self._view(end)
