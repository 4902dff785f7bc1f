"""How late an arm is on its set-points, measured while it moves, so that they can be sent that early."""

from collections import deque
from dataclasses import replace

import numpy as np

from cell.devices import TrajectoryPiece
from cell.poses import Array

_MOST_S = 0.03
_GAIN = 0.05  # of what one look shows
_LEAST_RAD_S = 0.1  # slower, noise of the joints would say more than their lag
_LOOKED_S = 0.05  # of a residual; beyond that something else happened


class Lag:
    """Servoing takes a control cycle and the wire some time; both are of the arm and of the machine."""

    def __init__(self) -> None:
        self.s = 0.0
        self._wanted: deque[TrajectoryPiece] = deque(maxlen=16)

    def ahead(self, piece: TrajectoryPiece) -> TrajectoryPiece:
        """``piece`` as it has to be sent for the arm to be on it."""
        self._wanted.append(piece)
        return replace(piece, t0=piece.t0 - self.s, t1=piece.t1 - self.s)

    def look(self, t: float, q: Array) -> None:
        """The arm's joints ``q`` (6,) at ``t``."""
        piece = next((p for p in reversed(self._wanted) if p.t0 <= t <= p.t1), None)
        if piece is None:
            return
        k = np.arange(len(piece.coefficients))
        tau = t - piece.t0
        wanted = tau**k @ piece.coefficients
        speed = (k[1:] * tau ** k[:-1]) @ piece.coefficients[1:]
        if np.max(np.abs(speed)) < _LEAST_RAD_S:
            return
        late = float((wanted - q) @ speed / (speed @ speed))
        if abs(late) < _LOOKED_S:
            self.s = float(np.clip(self.s + _GAIN * late, 0.0, _MOST_S))
