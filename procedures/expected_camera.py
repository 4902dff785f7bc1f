"""The camera that a job will look through, as far as it is known before anything moves."""

from dataclasses import dataclass
from math import atan2, degrees
from typing import Any

from cell.usual_camera import usual_K
from procedures.rehearsal import pictures
from procedures.setup import Setup


@dataclass(frozen=True)
class ExpectedCamera:
    """``table``: ``width``, ``height``, ``K`` and ``dist`` as a data set has them; ``words`` say what of it
    is assumed, or that its lens was found."""

    table: dict[str, Any]
    words: str


def expected_camera(setup: Setup, role: str) -> ExpectedCamera:
    """With the lens that the hand-eye in effect found for pictures of the size in the section of the camera
    with this role, else with a usual one."""
    known = pictures(setup, role)
    size = f"{known.width} x {known.height} pixels"
    if (lens := known.lens) is not None:
        K, dist = list(lens.K), list(lens.dist)
        words = f"the lens that the hand-eye in effect has for pictures of {size}"
    else:
        K, dist = list(usual_K(known.width, known.height)), []
        words = f"a camera of {size} and {degrees(2.0 * atan2(known.width / 2.0, K[0])):.0f} degrees"
    return ExpectedCamera({"width": known.width, "height": known.height, "K": K, "dist": dist}, words)
