"""The uncertainty of a camera's pose by what causes it, as results and predictions list it."""

from collections.abc import Mapping
from typing import TypedDict

import numpy as np

from calibration.adjustment.shared_errors import ATTITUDE, PLACE
from calibration.adjustment.unknowns import GEARS, GEOMETRY, LENS_BLOCK, TARGET_BLOCK
from cell.poses import Array

_CAUSES = {
    "arm": (GEOMETRY, GEARS, PLACE, ATTITUDE),
    "lens": (LENS_BLOCK,),
    "target": (TARGET_BLOCK,),
    "noise": ("noise",),
}


class Share(TypedDict):
    """Standard uncertainty of the place ``t`` (m) and the rotation ``r`` (rad) by one cause, ``block``."""

    block: str
    t: float
    r: float


def by_cause(budget: Mapping[str, Array]) -> list[Share]:
    """From variances (6,) of the pose by block of the adjustment; a cause without a block has zero."""
    shares = []
    for cause, blocks in _CAUSES.items():
        parts = np.maximum(sum((budget[b] for b in blocks if b in budget), np.zeros(6)), 0.0)
        t, r = np.sqrt([parts[:3].sum(), parts[3:].sum()]).tolist()
        shares.append(Share(block=cause, t=t, r=r))
    return shares


def largest(shares: list[Share], of: str) -> str:
    """The cause with the largest share; ``of`` is ``t`` or ``r``."""
    return max(shares, key=lambda share: share["t"] if of == "t" else share["r"])["block"]
