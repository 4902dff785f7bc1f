"""Whether the tracker stood still: what looks at reflectors that are fixed in the base say.

A monument moved when it is seen further from where it was at first than ``max_drift_m``, and than the noise
of two readings explains. Whether the stand or the monument moved, only several of them tell.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import chdtri

from cell.poses import Array

_CHANCE = 1e-6  # of taking noise for a move
_DRIFT_CHANCE = 1e-3
_ALIKE = 0.5  # monuments that move alike by more than this share say that it was the stand


@dataclass(frozen=True, eq=False)
class Moved:
    """How far a monument is from where it was (3,) m, and the standard deviation of that along one axis."""

    name: str
    shift: Array
    sigma_m: float

    @property
    def distance_m(self) -> float:
        return float(np.linalg.norm(self.shift))

    def beyond(self, chance: float) -> bool:
        """Whether noise moves it so far with less than this probability."""
        return (self.distance_m / self.sigma_m) ** 2 > float(chdtri(3, chance))


def first_seen(looks: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Every monument as the first look that could see it has it."""
    points: dict[str, Any] = {}
    for look in looks:
        points = {**look["points"], **points}
    return points


def compare(first: Mapping[str, Any], now: Mapping[str, Any]) -> list[Moved]:
    """``points`` of two looks: by name ``p_tracker`` (3,) m and ``sigma_m``; those that both have seen."""
    return [
        Moved(
            name,
            np.subtract(now[name]["p_tracker"], first[name]["p_tracker"]),
            float(np.hypot(now[name]["sigma_m"], first[name]["sigma_m"])),
        )
        for name in first
        if name in now
    ]


def moved_text(moved: Sequence[Moved], limit_m: float) -> str | None:
    """What moved beyond ``limit_m`` and noise, in words; None when everything stands."""
    gone = [m for m in moved if m.distance_m > limit_m and m.beyond(_CHANCE)]
    if not gone:
        return None
    named = ", ".join(f"{m.name} by {1e3 * m.distance_m:.3f} mm" for m in gone)
    return f"{_culprit(moved, gone)}: {named} since the first look, the limit is {1e3 * limit_m:g} mm"


def _culprit(moved: Sequence[Moved], gone: Sequence[Moved]) -> str:
    if len(moved) == 1:
        return "the tracker's stand or the monument moved"
    if len(gone) == 1:
        return f"monument {gone[0].name} moved, the others stand"
    return "the tracker's stand moved" if len(gone) > _ALIKE * len(moved) else "several monuments moved"


def drift_summary(looks: Sequence[Mapping[str, Any]], limit_m: float, samples: int) -> dict[str, Any] | None:
    """All looks for a result: how far each monument was off and when; None without any look.

    One that shares no monument with the first look vouches for nothing and does not count as a look.
    """
    if not looks:
        return None
    first = looks[0]["points"]
    rounds, largest, drifting, beyond, last = [], 0.0, False, False, looks[0]
    for look in looks[1:]:
        moved = compare(first, look["points"])
        if not moved:
            continue
        last = look
        beyond |= moved_text(moved, limit_m) is not None
        largest = max([largest, *(m.distance_m for m in moved)])
        drifting |= any(m.beyond(_DRIFT_CHANCE / max(len(moved), 1)) for m in moved)
        rounds.append(
            {
                "after": look["after"],
                "t": look["t"],
                "moved": {
                    m.name: {"shift_m": m.shift.tolist(), "moved_m": m.distance_m, "sigma_m": m.sigma_m}
                    for m in moved
                },
            }
        )
    return {
        "limit_m": limit_m,
        "names": sorted(first),
        "looks": rounds,
        "max_moved_m": largest,
        "beyond_noise": drifting,
        "beyond_limit": beyond,
        "samples_since_last_look": samples - int(last["after"]),
        "meaning": "distance (m) of each monument from where the first look saw it, in the tracker frame",
    }
