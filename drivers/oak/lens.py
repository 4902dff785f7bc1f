"""A lens that can move: where it was calibrated, and that it stays there.

The intrinsics in a camera's memory are those of one position of its lens. An autofocus changes the focal
length by some thousandths, so it is switched off, and every frame is looked at for where its lens was.
"""

from cell.errors import error


class LensWatch:
    """``wanted`` is the position to stay at; None takes that of the first frame that tells one."""

    def __init__(self, wanted: int | None = None) -> None:
        self.wanted = wanted
        self._arrived = False

    def usable(self, position: int | None) -> bool:
        """Whether a frame with the lens at ``position`` counts; a lens without one cannot move.

        False while the lens is on its way for the first time; later ``CAMERA_LENS_MOVED``.
        """
        if position is None:
            return True
        if self.wanted is None:
            self.wanted = position
        if position == self.wanted:
            self._arrived = True
            return True
        if not self._arrived:
            return False
        raise error("CAMERA_LENS_MOVED", f"the lens is at {position} of 255, and it was at {self.wanted}")
