"""Where an arm was left when a silence interrupted it, and whether somebody moved it meanwhile."""

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from cell.devices import ArmState
from cell.errors import error
from cell.samples import Sample

STAYED_RAD = 0.002
STOPPING_S = 0.6  # silence that goes unnoticed, the controller's watchdog, and braking


class WhereLeft:
    """The state from which the arm can have got no farther than stopping takes it.

    It is kept over a row of interruptions, or many small movements would add up unseen.
    """

    def __init__(self, fastest_rad_s: float) -> None:
        """``fastest_rad_s``: of a joint in any move, rad/s."""
        self._fastest_rad_s = fastest_rad_s
        self._left: Sample[ArmState] | None = None
        self._under_way = False  # a move was sent and not seen to end

    @contextmanager
    def moving(self) -> Iterator[None]:
        """Around whatever moves the arm: until it returns, the arm may be anywhere on its way."""
        self._left, self._under_way = None, True
        yield
        self._under_way = False

    def leave(self, newest: Sample[ArmState] | None) -> None:
        """The arm is being stopped; ``newest`` is what was seen last."""
        self._left = self._left or newest

    def found(self, name: str, resting: Sample[ArmState]) -> None:
        """The arm rests here; ``ARM_MOVED`` when stopping does not take it so far."""
        if self._left is not None:
            state, stopping = self._left.value, 0.0
            if self._under_way or not state.at_rest:
                stopping = STOPPING_S * max(float(np.max(np.abs(state.qd))), self._fastest_rad_s)
            away = float(np.max(np.abs(resting.value.q - state.q)))
            if away > STAYED_RAD + stopping:
                raise error(
                    "ARM_MOVED",
                    f"{name}: a joint is {away:.4f} rad from where it was seen last; "
                    f"stopping takes {STAYED_RAD + stopping:.4f} rad at most",
                )
        if self._left is None or self._under_way or not self._left.value.at_rest:
            self._left, self._under_way = resting, False
