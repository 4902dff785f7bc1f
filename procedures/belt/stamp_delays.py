"""What is known of how late the stamps of camera and encoder are: a constant error that no contact shows.

A stamp that is late by 10 ms puts each item 1 mm off along a belt of 0.1 m/s, always to the same side, and
counts and pictures of the run agree with each other all the same.
"""

import math
from collections.abc import Mapping

from cell.formats.result import Warning_

_SIGMAS_95 = 1.96
_SOURCES = {"fixed_camera": "camera", "belt": "encoder"}  # role, and the device in words
Offsets = Mapping[str, Mapping[str, float]]


def delays_95_s(offsets: Offsets) -> float | None:
    """Half of the 95 % interval of both delays together, s; None where one was not measured.

    ``offsets`` are those in effect by role, with the ``sigma`` of one that was measured.
    """
    if _unmeasured(offsets):
        return None
    return _SIGMAS_95 * math.hypot(*(offsets[role]["sigma"] for role in _SOURCES))


def delay_warnings(offsets: Offsets) -> list[Warning_]:
    """One where a delay is not known, with what that can cost and what measures it."""
    if not (roles := _unmeasured(offsets)):
        return []
    devices = " and ".join(_SOURCES[role] for role in roles)
    jobs = " and ".join(f'source = "{role}"' for role in roles)
    text = (
        f"how late the stamps of the {devices} are was not measured: 10 ms would put every contact off by 1 "
        f"mm along the belt at 0.1 m/s, unseen here; run latency-calibration with {jobs}"
    )
    return [Warning_(code="belt.delays", text=text)]


def _unmeasured(offsets: Offsets) -> list[str]:
    return [role for role in _SOURCES if "sigma" not in offsets.get(role, {})]
