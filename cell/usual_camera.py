"""The lens of a camera that nobody has calibrated yet, as predictions and the twins of rehearsals have it."""

from collections.abc import Sequence

# 77 degrees across: an assumption. Pictures of other sizes show the same sight, cut off above and below or at
# the sides where their shape is another one, as depthai cuts it.
WIDTH, HEIGHT, FOCAL_PX = 1280, 800, 800.0


def larger(width: int, height: int) -> float:
    """By how much a pixel of the size above is larger than one of ``width`` x ``height``."""
    return max(width / WIDTH, height / HEIGHT)


def usual_K(width: int, height: int) -> Sequence[float]:
    """fx, fy, cx, cy in pixels of such pictures, with the lens's axis in their middle."""
    focal = larger(width, height) * FOCAL_PX
    return [focal, focal, (width - 1) / 2.0, (height - 1) / 2.0]
