"""How an arm is late on its set-points, measured while it moves, so that they can be sent to make up for it.

A controller delays what it is sent, smooths it, or both; which of them is not published. So several answers
run beside the arm, each a delay and a low-pass of first order that share a lag differently. Each learns its
own lag from where the arm is, and the one that has lately described it best is made up for: its low-pass by
sending ``y + tau y'`` for ``y``, its delay by sending that early.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import replace
from itertools import groupby
from math import ceil

import numpy as np

from cell.devices import TrajectoryPiece
from cell.following import MOST_LAG_S
from cell.poses import Array
from procedures.belt.motion.tool_joints import along_piece, joints_on_piece

_SHARES: Array = np.array([0.0, 0.25, 0.5, 0.75, 1.0])  # of the lag that is low-pass
_GAIN = 0.05  # of what one look shows
_LEAST_RAD_S = 0.1  # slower, noise of the joints would say more than their lag
_STEP_S = 0.004  # of the answers that run beside the arm
_FORGET, _BETTER = 0.02, 0.7  # of squares that are compared; so much better, and another answer is taken
_MAKE_UP = 1.0, 0.5  # of the low-pass, as far as the limits of the arm let


class Lag:
    """Begins with a delay of what the arm's settings let expect; the lag may become whatever a controller can
    cause."""

    def __init__(self, expected_s: float) -> None:
        self._lags: Array = np.full(len(_SHARES), expected_s)
        self._squares: Array = np.zeros(len(_SHARES))
        self._best = 0
        self._wanted: deque[TrajectoryPiece] = deque()
        self._sent: deque[TrajectoryPiece] = deque()
        # Set-points as they were in force: when (m,), and the joints (m, 6).
        self._line: tuple[Array, Array] = np.empty(0), np.empty((0, 6))
        self._at: Array = np.zeros((len(_SHARES), 6))  # where each answer has the arm

    @property
    def s(self) -> float:
        """How late the arm is on a steady way, s."""
        return float(self._lags[self._best])

    @property
    def delay_s(self) -> float:
        """How early set-points are sent; the rest of :attr:`s` is the low-pass."""
        return float((1.0 - _SHARES[self._best]) * self.s)

    def begin(self, t: float, q: Array) -> None:
        """The arm rests at ``q`` (6,) at ``t``."""
        self._wanted.clear()
        self._sent.clear()
        self._line = np.array([t]), np.array([q])
        self._at[:] = q

    def ahead(self, piece: TrajectoryPiece, allowed: Callable[[TrajectoryPiece], bool]) -> TrajectoryPiece:
        """``piece`` as it has to be sent for the arm to be on it, with set-points that are ``allowed``."""
        self._wanted.append(piece)
        smooth_s = self.s - self.delay_s
        for part in _MAKE_UP if smooth_s > 0.0 else ():
            sent = _early(piece, part * smooth_s, self.s - part * smooth_s)
            if allowed(sent):
                break
        else:
            sent = _early(piece, 0.0, self.s)
        self._sent.append(sent)
        for pieces in (self._wanted, self._sent):
            while pieces[0].t1 < piece.t0 - 2.0 * MOST_LAG_S:
                pieces.popleft()
        return sent

    def look(self, t: float, q: Array) -> Array | None:
        """The arm's joints ``q`` (6,) at ``t``; returns where they were wanted then, if that is known."""
        if self._sent and len(self._line[0]) and t > self._line[0][-1]:
            self._learn(t, q)
        piece = next((p for p in reversed(self._wanted) if p.t0 <= t <= p.t1), None)
        return None if piece is None else joints_on_piece(piece, t)

    def _learn(self, t: float, q: Array) -> None:
        speeds = self._advance(t)
        if np.max(np.abs(speeds)) < _LEAST_RAD_S:
            return
        off = self._at - q
        self._squares += _FORGET * (np.sum(off**2, axis=1) - self._squares)
        late = np.sum(off * speeds, axis=1) / np.maximum(np.sum(speeds**2, axis=1), _LEAST_RAD_S**2)
        self._lags += _GAIN * np.clip(late, -MOST_LAG_S, MOST_LAG_S)
        np.clip(self._lags, 0.0, MOST_LAG_S, out=self._lags)
        best = int(np.argmin(self._squares))
        if self._squares[best] < _BETTER * self._squares[self._best]:
            self._best = best

    def _advance(self, t: float) -> Array:
        """Every answer on to ``t``; returns how fast each has the joints turn, (n, 6) rad/s."""
        stamps, joints = self._line
        begun = float(stamps[-1])
        steps = max(ceil((t - begun) / _STEP_S), 1)
        step = (t - begun) / steps
        times = begun + step * np.arange(1, steps + 1)
        sent = [self._sent_along(piece, list(some)) for piece, some in groupby(times.tolist(), self._sent_at)]
        first = max(int(np.searchsorted(stamps, begun - MOST_LAG_S - _STEP_S)) - 1, 0)
        stamps = np.concatenate([stamps[first:], times])
        joints = np.concatenate([joints[first:], *sent])
        self._line = stamps, joints
        tau = np.maximum(_SHARES * self._lags, 1e-6)[:, None]
        kept = np.exp(-step / tau)
        whens = np.array([begun, *times])[:, None] - (1.0 - _SHARES) * self._lags
        seen, before = _between(stamps, joints, whens.ravel()).reshape(*whens.shape, 6), self._at
        behind = tau * np.diff(seen, axis=0) / step  # of what is sent on a steady way
        for goes_to in seen[1:] - behind - kept * (seen[:-1] - behind):
            before = self._at
            self._at = goes_to + kept * before
        return np.asarray((self._at - before) / step)

    def _sent_along(self, piece: TrajectoryPiece | None, times: list[float]) -> Array:
        """(n, 6) joints of ``piece`` at ``times`` (n,); without one, the arm stays."""
        if piece is None:
            return np.repeat(self._line[1][-1:], len(times), axis=0)
        return along_piece(piece, np.array(times))

    def _sent_at(self, t: float) -> TrajectoryPiece | None:
        """The piece that is in force at ``t``."""
        return next((p for p in reversed(self._sent) if p.t0 <= t), None)


def _early(piece: TrajectoryPiece, tau: float, early_s: float) -> TrajectoryPiece:
    """``y + tau y'`` for the polynomial ``y`` of ``piece``, that much early."""
    c = np.array(piece.coefficients, dtype=float)
    c[:-1] += tau * np.arange(1.0, len(c))[:, None] * c[1:]
    return replace(piece, t0=piece.t0 - early_s, t1=piece.t1 - early_s, coefficients=c)


def _between(stamps: Array, joints: Array, times: Array) -> Array:
    """(n, 6) of the line ``joints`` (m, 6) at ``stamps`` (m,), linear between them, at ``times`` (n,)."""
    k = np.clip(np.searchsorted(stamps, times), 1, len(stamps) - 1)
    part = np.clip((times - stamps[k - 1]) / (stamps[k] - stamps[k - 1]), 0.0, 1.0)[:, None]
    out: Array = joints[k - 1] + part * (joints[k] - joints[k - 1])
    return out
