"""Following polynomials as servo set-points, with a ramp to rest when they are not renewed.

Pure arithmetic without numpy: it runs at 500 Hz in the motion child, which has to start fast.
"""

from dataclasses import dataclass
from enum import StrEnum

Joints = list[float]


class End(StrEnum):
    """Why following ended."""

    DONE = "done"  # the trajectory was finished and followed to its end
    NOT_RENEWED = "not renewed"  # the horizon passed without a new piece or beat
    STOPPED = "stopped"  # someone asked for a stop


@dataclass(frozen=True)
class Piece:
    """``q(t) = sum_k coefficients[k] (t - t0)^k`` for ``t0 <= t <= t1``, CLOCK_MONOTONIC seconds, rad."""

    t0: float
    t1: float
    coefficients: list[Joints]

    def at(self, t: float) -> tuple[Joints, Joints]:
        """Joint positions and speeds at ``t`` by Horner's rule."""
        s = t - self.t0
        rows = self.coefficients
        q = list(rows[-1])
        qd = [0.0] * len(q)
        for row in reversed(rows[:-1]):
            for j, c in enumerate(row):
                qd[j] = qd[j] * s + q[j]
                q[j] = q[j] * s + c
        return q, qd


@dataclass(frozen=True)
class _Ramp:
    start: float
    q: Joints
    qd: Joints
    duration: float
    end: End

    def at(self, t: float) -> Joints:
        """Speeds fall linearly to zero, all joints together."""
        s = min(max(t - self.start, 0.0), self.duration)
        travel = s - (s * s / (2.0 * self.duration) if self.duration > 0.0 else 0.0)
        return [q + v * travel for q, v in zip(self.q, self.qd, strict=True)]


class Follower:
    """The set-point for every instant.

    A set-point is valid until the end of its piece and until ``horizon_s`` after the newest beat of the
    daemon, whichever comes first; then the joints ramp to rest with at most ``decel`` rad/s^2 and are held
    for ``settle_s``, so that the arm has caught up before servoing ends.

    Without a set-point for ``gap_s``, as where this process got no core, the controller has brought the arm
    to rest at the latest one. It is held: the set-point of the moment would be a leap, which the arm would
    follow as fast as it can.
    """

    def __init__(self, horizon_s: float, decel: float, settle_s: float, gap_s: float = 0.05) -> None:
        self._horizon_s, self._decel, self._settle_s = horizon_s, decel, settle_s
        self._gap_s = gap_s
        self._sent: tuple[float, Joints] | None = None  # the latest set-point, and when
        self._pieces: list[Piece] = []
        self._finished = False
        self._stop_asked = False
        self._ramp: _Ramp | None = None

    def add(self, piece: Piece) -> None:
        """Follow ``piece`` from its ``t0`` on; it replaces whatever was planned after that instant."""
        self._pieces = [p for p in self._pieces if p.t0 < piece.t0]
        self._pieces.append(piece)

    def finish(self) -> None:
        """No further pieces come: the end of the last one is the end of the trajectory."""
        self._finished = True

    def stop(self) -> None:
        """Ramp to rest from now on."""
        self._stop_asked = True

    def setpoint(self, now: float, beat: float) -> Joints | None:
        """Joints to command at ``now``, or None before the first piece begins."""
        q = self._held(now) or self._planned(now, beat)
        if q is not None:
            self._sent = now, q
        return q

    def _held(self, now: float) -> Joints | None:
        """The latest set-point, after a time without one; the arm rests at the first piece's begin before."""
        if self._sent is None:
            piece = self._current(now)
            if piece is None:
                return None
            self._sent = piece.t0, piece.at(piece.t0)[0]
        then, q = self._sent
        if now - then <= self._gap_s:
            return None
        end = End.NOT_RENEWED
        if self._stop_asked:
            end = End.STOPPED
        elif self._ramp is not None and self._ramp.at(now) == q:
            end = self._ramp.end
        self._ramp = _Ramp(now, q, [0.0] * len(q), 0.0, end)
        return q

    def _planned(self, now: float, beat: float) -> Joints | None:
        if self._ramp is None:
            piece = self._current(now)
            if piece is None:
                return None
            limit = min(piece.t1, beat + self._horizon_s)
            if now <= limit and not self._stop_asked:
                return piece.at(now)[0]
            self._ramp = self._begin_ramp(piece, min(now, limit))
        return self._ramp.at(now)

    @property
    def broken_off(self) -> End | None:
        """Why the trajectory is followed no more before its end, as soon as that is so."""
        return None if self._ramp is None or self._ramp.end is End.DONE else self._ramp.end

    def ended(self, now: float, beat: float) -> End | None:
        """Why it is over, once the ramp and the settling time have passed."""
        if self._ramp is not None:
            return self._ramp.end if now >= self._ramp.start + self._ramp.duration + self._settle_s else None
        if self._current(now) is None:
            if self._stop_asked:
                return End.STOPPED
            if self._finished and not self._pieces:
                return End.DONE
            if now > beat + self._horizon_s:
                return End.NOT_RENEWED
        return None

    def _current(self, now: float) -> Piece | None:
        while len(self._pieces) > 1 and self._pieces[1].t0 <= now:
            del self._pieces[0]
        return self._pieces[0] if self._pieces and self._pieces[0].t0 <= now else None

    def _begin_ramp(self, piece: Piece, start: float) -> _Ramp:
        start = max(start, piece.t0)
        q, qd = piece.at(start)
        if self._stop_asked:
            end = End.STOPPED
        elif self._finished and len(self._pieces) == 1 and start >= piece.t1:
            end = End.DONE
        else:
            end = End.NOT_RENEWED
        return _Ramp(start, q, qd, max(map(abs, qd)) / self._decel, end)
