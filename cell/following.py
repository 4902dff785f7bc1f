"""Whether an arm does what a stream tells it: at full speed, and somewhere on the way of its set-points.

An arm is on its set-points late, by the look-ahead of its controller. A late arm is nothing bad: whoever
streams learns the delay. An arm that is nowhere near any set-point of the last moments is another matter,
and so is a controller that works off its set-points more slowly than they come.
"""

from collections import deque

import numpy as np

from cell.devices import ArmState, TrajectoryPiece
from cell.errors import error
from cell.poses import Array
from cell.samples import Readings

MOST_LAG_S = 0.35  # a look-ahead of 0.2 s, the longest of UR's, and what gain, wire and cycle add
LIMIT_RAD = 0.05  # a low-pass of 0.06 s cuts the corners of 12 rad/s^2 by 0.02
STEP_S = 0.01  # between the set-points that are remembered
FULL_SPEED = 0.995
SCALED_FOR_S = 0.05  # a limiter may touch for a cycle


LOOKS = 5  # along a piece, for the guard


def along(piece: TrajectoryPiece) -> tuple[Array, Array]:
    """Joints and joint speeds (n, 6) at points of ``piece``, first and last among them."""
    powers = np.arange(len(piece.coefficients))
    spans = np.linspace(0.0, piece.t1 - piece.t0, LOOKS)[:, None]
    return spans**powers @ piece.coefficients, (powers[1:] * spans ** powers[:-1]) @ piece.coefficients[1:]


def require_full_speed(name: str, state: ArmState) -> None:
    """``ARM_SPEED_SCALED`` when the controller of arm ``name`` would run set-points more slowly than sent."""
    if state.speed_scaling < FULL_SPEED:
        raise error("ARM_SPEED_SCALED", f"{name} runs at {100 * state.speed_scaling:.0f} % of full speed")


class Following:
    """Told of every piece that is sent; looks at the newest state of the arm then."""

    def __init__(self, name: str, states: Readings[ArmState]) -> None:
        self._name, self._states = name, states
        self._line: deque[tuple[float, Array]] = deque()  # set-points as they came into force
        self._piece: TrajectoryPiece | None = None
        self._scaled_since: float | None = None

    def sent(self, piece: TrajectoryPiece) -> None:
        """``piece`` replaces what was planned from its begin on.

        Raises ``ARM_SPEED_SCALED`` or ``ARM_NOT_FOLLOWING`` by what the arm shows of the pieces before.
        """
        if (sample := self._states.last()) is not None:
            self._judge_scaling(sample.t, sample.value)
            self._judge_place(sample.t, sample.value.q)
        before, self._piece = self._piece, piece
        if before is not None:
            times = np.arange(before.t0, min(piece.t0, before.t1) + 0.5 * STEP_S, STEP_S)
            self._line.extend(zip(times.tolist(), _at(before, times), strict=True))
        while len(self._line) > 1 and self._line[1][0] < piece.t0 - 2.0 * MOST_LAG_S:
            self._line.popleft()

    def _judge_scaling(self, t: float, state: ArmState) -> None:
        if state.speed_scaling >= FULL_SPEED:
            self._scaled_since = None
            return
        self._scaled_since = t if self._scaled_since is None else self._scaled_since
        if t - self._scaled_since >= SCALED_FOR_S:
            require_full_speed(self._name, state)

    def _judge_place(self, t: float, q: Array) -> None:
        piece = self._piece
        if piece is None or not self._line:
            return
        first = self._line[0][1]
        recent = [at for when, at in self._line if t - MOST_LAG_S <= when <= t] or [first]
        if self._line[0][0] > t - MOST_LAG_S:
            recent.append(first)  # where the stream began
        if t > piece.t0:
            times = np.arange(piece.t0, min(t, piece.t1) + STEP_S, STEP_S)
            recent.extend(_at(piece, np.minimum(times, piece.t1)))
        off = float(np.min(np.max(np.abs(np.array(recent) - q), axis=1)))
        if off > LIMIT_RAD:
            raise error(
                "ARM_NOT_FOLLOWING",
                f"a joint of {self._name} is {off:.3f} rad from every set-point of the last {MOST_LAG_S:g} s",
            )


def _at(piece: TrajectoryPiece, times: Array) -> Array:
    """Joints (n, 6) of ``piece`` at ``times`` (n,)."""
    powers = np.arange(len(piece.coefficients))
    out: Array = (times - piece.t0)[:, None] ** powers @ piece.coefficients
    return out
