"""How the arm follows its set-points: its lag, and how far the tool is beside where it is meant to be."""

from math import exp, sqrt

import numpy as np

from cell.devices import TrajectoryPiece
from cell.errors import CellError, error
from cell.following import along
from cell.guard import MotionGuard
from cell.poses import Array
from procedures.belt.contact_uncertainty import ContactBudget
from procedures.belt.motion.contact_check import ContactCheck
from procedures.belt.motion.servo_lag import Lag

_MEMORY_S = 0.2  # of squares
_LONGEST_S = 0.04  # that one look stands for: between two grips nobody looks
# One look counts as so many limits at most: a PC that pauses for some hundredths of a second leaves the arm
# behind by far more in two or three looks, and on its way again after them. That costs the item at most.
_MOST = 1.25


class ArmFollowing:
    """Of one run. Distances are of the tool's point from its set-points at the same time, at an item."""

    def __init__(
        self, expected_lag_s: float, limit_m: float, guard: MotionGuard, budget: ContactBudget | None = None
    ) -> None:
        self.lag, self.contacts = Lag(expected_lag_s), ContactCheck(budget)
        self._limit_m, self._guard = limit_m, guard
        self._squares, self._level = 0.0, np.zeros((2, 2))
        self._looked: float | None = None
        self._lately = 0.0
        self._limited = 0.0  # the same, of looks that count as at most ``_MOST`` limits
        self.looks = 0
        self.largest_m = 0.0

    @property
    def delay_s(self) -> float:
        """How early set-points are sent."""
        return self.lag.delay_s

    def ahead(self, piece: TrajectoryPiece) -> TrajectoryPiece:
        """``piece`` as it is sent: the guard lets its set-points pass, as it does those of ``piece``."""
        return self.lag.ahead(piece, self._allowed)

    def _allowed(self, piece: TrajectoryPiece) -> bool:
        try:
            self._guard.check_setpoints(*along(piece))
        except CellError:
            return False
        return True

    @property
    def rms_m(self) -> float | None:
        """Of all looks; None before the first."""
        return sqrt(self._squares / self.looks) if self.looks else None

    @property
    def level(self) -> Array | None:
        """(2, 2) m^2, x and y: mean squares and product of all looks; None before the first."""
        return self._level / self.looks if self.looks else None

    @property
    def lately_m(self) -> float:
        """RMS of the last looks; 0 before the first."""
        return sqrt(self._lately)

    @property
    def left_behind(self) -> str | None:
        """What is warned of where the tool was farther from its set-points than the limit for a moment."""
        if self.largest_m <= self._limit_m:
            return None
        return (
            f"the tool was up to {1e3 * self.largest_m:.1f} mm from its set-points during a grip, for a "
            "moment, as after a pause of the PC: an item taken then may be held askew or be left behind"
        )

    def live(self) -> dict[str, float]:
        """Numbers of now."""
        return {"arm_lag_s": self.lag.s, "following_error_m": self.lately_m}

    def look(self, t: float, tool: Array, wanted: Array) -> None:
        """The tool's point (3,) as it is and as it is meant to be at ``t`` (s).

        ``ARM_NOT_FOLLOWING`` when it stays beside it: for 0.2 s by 1.25 limits or more, for longer
        by less.
        """
        off = tool - wanted
        square = float(np.sum(off**2))
        self._level += np.outer(off[:2], off[:2])
        self.looks += 1
        self._squares += square
        self.largest_m = max(self.largest_m, sqrt(square))
        passed = _LONGEST_S if self._looked is None else min(max(t - self._looked, 0.0), _LONGEST_S)
        self._looked, share = t, 1.0 - exp(-passed / _MEMORY_S)
        self._lately += share * (square - self._lately)
        self._limited += share * (min(square, (_MOST * self._limit_m) ** 2) - self._limited)
        if self._limited > self._limit_m**2:
            raise error(
                "ARM_NOT_FOLLOWING",
                f"the tool was {1e3 * self.lately_m:.1f} mm beside its set-points at an item; "
                f"following_limit_m is {1e3 * self._limit_m:g} mm",
            )
