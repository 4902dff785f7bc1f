"""When the counts were taken: stamps of a periodic sender, freed from the jitter of their way.

An encoder sends every ``period``; its frames are stamped when they arrive, late by a jitter that is worth
``speed * jitter`` of belt. The sender's own rhythm is a straight line through the stamps. Whether the stamps
or the rhythm tell the truth is not assumed: an encoder that is sampled irregularly but stamped well is as
possible, and the counts themselves tell, because the belt moves smoothly in the true time.
"""

from dataclasses import dataclass
from math import sqrt

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from cell.poses import Array

_PHASE, _RATE = 0.1, 0.005  # gains of the loop that numbers the frames
_LOST_RHYTHM = 0.5  # s without a frame
_LOST = 0.6  # of a period: later than this, a frame is missing; lost frames are rarer than late ones
_PULL = 0.3  # of a period; one late frame does not pull the rhythm further
_FOLLOW = 0.2  # of the change in what a frame adds
_TELLING = 3.0  # counts that a frame adds at least, for its count to tell whether one before it was lost
_BURST = 12  # frames that may come at once after a stall
_QUANTUM = 12.0**-0.5  # counts; what rounding alone leaves
_RECENT = 40  # blocks
_BLOCK = 16  # frames in which the belt's motion is a parabola
_RHYTHM = 0.35  # of a period: stamps further than this from the rhythm are late ones
_STEP = 0.9  # of a period
_NEAR = 4  # frames on either side that show a stray one
_FAR, _FAR_SIGMAS = 2.0, 6.0  # counts
_MOST_LATE = 0.5  # share of late stamps beyond which there is no rhythm


@dataclass
class FrameCounter:
    """Numbers the frames of a sender by their stamps, lost ones counted; the period follows the sender.

    A frame that comes before its turn belongs to a burst after a stall: it shares the number before it, and
    :func:`distinct` moves the stalled ones back. A frame that comes late is told from the one after a lost
    frame by its count, where the belt moves fast enough for that.
    """

    period: float
    _slot: int = 0
    _due: float | None = None
    _open: int = 0  # numbers left out lately, which a burst may fill
    _since: int = 0  # frames since then
    _n: float = 0.0  # the last count, and what frames lately added
    _each: float = 0.0

    def add(self, t: float, n: float) -> int:
        """The number of the frame with count ``n`` (unwrapped) stamped ``t`` (s)."""
        gained, self._n = n - self._n, n
        if self._due is None or t - self._due > _LOST_RHYTHM:
            missed = 0 if self._due is None else round((t - self._due) / self.period)
            self._slot += 1 + missed
            self._due = t + self.period
            self._open, self._each = 0, 0.0
            return self._slot
        late = t - self._due
        missed = self._missed(late / self.period, gained)
        if missed == 0:
            self._each += _FOLLOW * (gained - self._each)
        late -= missed * self.period
        late = min(max(late, -_PULL * self.period), _PULL * self.period)
        self._slot += 1 + missed
        self.period += _RATE * late
        self._due += (1 + missed) * self.period + _PHASE * late
        return self._slot

    def _missed(self, late: float, gained: float) -> int:
        """Frames lost before one that is ``late`` periods late; -1 when it belongs to a burst."""
        self._since += 1
        if self._since > _BURST:
            self._open = 0
        missed = int(late + 1.0 - _LOST)
        if missed > 0 and abs(self._each) >= _TELLING:
            missed = min(missed, max(round(gained / self._each) - 1, 0))
        if late < -_LOST and self._open > 0:
            missed = -1
        if missed > 0:
            self._since = 0
        self._open += missed
        return missed


def distinct(slots: NDArray[np.int64]) -> NDArray[np.int64]:
    """The same numbers, each frame one of its own: late frames move back into the gap that they left."""
    index = np.arange(len(slots))
    least = np.minimum.accumulate((slots - index)[::-1])[::-1]
    return np.asarray(least + index)


@dataclass(frozen=True)
class Timed:
    """When the counts were taken (k,), s, and the standard deviation of one count about the belt's motion.

    ``share`` is the part of the stamps' deviation from the rhythm that the counts follow; None where the
    stamps show no rhythm and stand as they are.
    """

    t: Array
    sigma: float
    share: float | None


def true_times(t: Array, slots: NDArray[np.int64], n: Array) -> Timed:
    """Times of the counts ``n`` (k,) with stamps ``t`` (k,) and frame numbers ``slots`` (k,).

    ``t_line + share * (t - t_line)``: ``share`` is found by regression in blocks of frames with the belt's
    own motion (a parabola) projected out of both sides.
    """
    if len(t) < 2 * _BLOCK:
        return Timed(t, _QUANTUM, None)
    slots = distinct(slots)
    line, period = _rhythm(t, slots)
    if period <= 0.0:  # most of them came at once, to a PC that had stood still
        return Timed(t, _QUANTUM, None)
    off = t - line
    if np.count_nonzero(np.abs(off) > _RHYTHM * period) > _MOST_LATE * len(t) or _steps(off, period):
        _, sigma = _share(slots, n, off, period, given=1.0)
        return Timed(t, sigma, None)
    share, sigma = _share(slots, n, off, period)
    return Timed(line + share * off, sigma, share)


def _rhythm(t: Array, slots: NDArray[np.int64]) -> tuple[Array, float]:
    """Straight line through the stamps that are not late.

    A frame is late at times and never early, so the earliest of each block begin; whoever lies near their
    line then makes it.
    """
    x, y = (slots - slots[-1]).astype(float), t - t[-1]
    period = float(y[0] / x[0]) if x[0] < 0.0 else 0.0
    k = len(x) // _BLOCK
    block = (y - period * x)[len(x) - k * _BLOCK :].reshape(k, _BLOCK)
    first = len(x) - k * _BLOCK + np.arange(k) * _BLOCK + np.argmin(block, axis=1)
    use = np.zeros(len(x), dtype=bool)
    use[first] = True
    fit, rate = np.zeros(len(t)), 0.0
    for turn in range(4):
        some = slice(None) if use.all() else use
        rate, at = _line(x[some], y[some])
        fit = rate * x + at
        off = y - fit
        centre = _median(off[some])
        apart = np.abs(off - centre)
        near = 4.0 * 1.4826 * _median(apart[some]) + 1e-6
        if turn == 0:  # from the envelope's line to all that are near it
            near = max(near, 0.5 * _RHYTHM * rate)
        again = apart <= near
        if np.array_equal(again, use) or np.count_nonzero(again) < 0.4 * len(t):
            break
        use = again
    return fit + t[-1], rate


def _median(x: Array) -> float:
    """Of numbers that are all finite, which spares the library's look for others."""
    k = len(x) // 2
    part = np.partition(x, (k - 1, k) if len(x) % 2 == 0 else k)
    return float(part[k] if len(x) % 2 else 0.5 * (part[k - 1] + part[k]))


def _medians(rows: Array) -> Array:
    """(k,) of the rows (k, m), all finite."""
    k = rows.shape[1] // 2
    ordered = np.sort(rows, axis=1)
    out: Array = ordered[:, k] if rows.shape[1] % 2 else 0.5 * (ordered[:, k - 1] + ordered[:, k])
    return out


def _line(x: Array, y: Array) -> tuple[float, float]:
    """Slope and value at 0 of the straight line through the points (k,) by least squares."""
    middle = float(x.mean())
    u = x - middle
    rate = float(u @ y) / max(float(u @ u), 1e-12)
    return rate, float(y.mean()) - rate * middle


def _steps(off: Array, period: float) -> bool:
    """Whether the deviation from the rhythm steps somewhere and stays: then a frame got a wrong number.

    A block that is late alone was held up with all its frames.
    """
    if np.ptp(off) <= _STEP * period:  # medians are no farther apart
        return False
    k = len(off) // _BLOCK
    middle = _medians(off[len(off) - k * _BLOCK :].reshape(k, _BLOCK))
    if k > 2:
        middle = _medians(sliding_window_view(middle, 3))
    return bool(np.ptp(middle) > _STEP * period)


def strays(t: Array, n: Array, sigma: float) -> NDArray[np.bool_]:
    """Which counts lie apart from the frames around them: swapped on their way, or with a wrong number.

    The newest frames are never strays: a belt that starts looks like that.
    """
    found = np.zeros(len(t), dtype=bool)
    wide = 2 * _NEAR
    if len(t) < 2 * wide + 1:
        return found
    speed = (n[2 * wide :] - n[: -2 * wide]) / np.maximum(t[2 * wide :] - t[: -2 * wide], 1e-9)
    speed = np.concatenate([np.full(_NEAR, speed[0]), speed, np.full(_NEAR, speed[-1])])
    most = _FAR + _FAR_SIGMAS * sigma
    # The median is far off only if five of the nine are: one of any four neighbours, which is rare.
    inner = slice(_NEAR, len(t) - _NEAR)
    doubt = np.zeros(len(speed), dtype=bool)
    for k in range(_NEAR // 2, _NEAR + _NEAR // 2 + 1):
        if k != _NEAR:
            there = slice(k, len(t) - wide + k)
            doubt |= np.abs(n[there] - n[inner] - speed * (t[there] - t[inner])) > most
    at = np.flatnonzero(doubt)
    rows = at[:, None] + np.arange(wide + 1)
    level = n[rows] - speed[at, None] * (t[rows] - t[at + _NEAR, None])
    usual = np.partition(level, _NEAR, axis=1)[:, _NEAR]  # the median of an odd number
    found[at + _NEAR] = np.abs(n[at + _NEAR] - usual) > most
    return found


def _parabolas() -> Array:
    u = np.linspace(-1.0, 1.0, _BLOCK)
    basis, _ = np.linalg.qr(np.stack([np.ones(_BLOCK), u, u * u], axis=1))
    return np.asarray(basis)


_PARABOLAS = _parabolas()  # (_BLOCK, 3), orthonormal


def _share(
    slots: NDArray[np.int64], n: Array, off: Array, period: float, given: float | None = None
) -> tuple[float, float]:
    """0 when the counts follow the rhythm, 1 when they follow the stamps; and what remains, in counts."""
    k = len(n) // _BLOCK
    rows = slice(len(n) - k * _BLOCK, None)
    s, c, d = (a[rows].reshape(k, _BLOCK) for a in (slots, n, off))
    whole = (s[:, -1] - s[:, 0]) == _BLOCK - 1
    if not whole.any():
        return 0.0, _QUANTUM
    c, d = c[whole], d[whole]
    e = c - c[:, :1]
    g = d * (e[:, -1:] / ((_BLOCK - 1) * period))
    # Sums over each block of the products of what the parabola leaves of both.
    e_of, g_of = e @ _PARABOLAS, g @ _PARABOLAS
    ee, eg, gg = (
        _dots(a, b) - _dots(x, y)
        for a, b, x, y in ((e, e, e_of, e_of), (e, g, e_of, g_of), (g, g, g_of, g_of))
    )
    share = given or 0.0
    for _ in range(2 if given is None else 0):
        left = (ee - 2.0 * share * eg + share**2 * gg) / (_BLOCK - 3)
        usual = left <= 4.0 * max(_median(left), _QUANTUM**2)  # not where the belt starts or stops
        share = min(max(float(eg @ usual) / (float(gg @ usual) + 1.0), 0.0), 1.0)
    left = (ee - 2.0 * share * eg + share**2 * gg)[-_RECENT:] / (_BLOCK - 3)
    return share, max(sqrt(max(_median(left), 0.0)), _QUANTUM)


def _dots(a: Array, b: Array) -> Array:
    """(k,) of the rows of both (k, m)."""
    out: Array = np.einsum("km,km->k", a, b)
    return out
