"""Which joints an observed arm can have, and which of them its calibration has sampled."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from calibration.identification.application import beyond
from cell.errors import error
from cell.poses import Array

OUTSIDE = "targets.outside-sampled"
_ROUNDING = 1e-9  # rad: of a joint at the end of its range


@dataclass(frozen=True, eq=False)
class JointRanges:
    """(j, 2) rad, lowest and highest: ``allowed`` is ``joint_ranges_rad`` of the sampling, ``sampled`` where
    it measured. None where the kinematics do not say: those accepted before they were kept."""

    allowed: Array | None
    sampled: Array | None

    @classmethod
    def of(cls, kinematics: Mapping[str, Any]) -> Self:
        """Of a version of ``kinematics.<device>``."""
        return cls(*(_array(kinematics.get(key)) for key in ("joint_ranges_rad", "joints_sampled_rad")))

    @property
    def middle(self) -> Array | None:
        """(j,) rad: of what was sampled, else of what is allowed."""
        known = self.allowed if self.sampled is None else self.sampled
        return None if known is None else known.mean(axis=1)

    def require_inside(self, Q: Array, whose: str) -> None:
        """``TARGETS_UNREACHABLE`` names a target whose joints in ``Q`` (k, j) are beyond, and the joint."""
        if self.allowed is None:
            return
        for k, off in enumerate(beyond(Q, self.allowed)):
            j = int(np.argmax(np.abs(off)))
            if abs(off[j]) > _ROUNDING:
                low, high = self.allowed[j]
                raise error(
                    "TARGETS_UNREACHABLE",
                    f"target {k + 1}: {whose} reaches it with joint {j + 1} at {Q[k, j]:.3f} rad at best; "
                    f"joint_ranges_rad of the sampling allows {low:g} to {high:g} rad",
                )


def outside_text(Q: Array, numbers: Sequence[int], sampled: Array | None) -> str | None:
    """Which targets ``numbers`` (k,) have joints ``Q`` (k, j) that the calibration did not sample; None
    without any. Each joint is compared alone."""
    if sampled is None:
        return "the kinematics in effect do not say which joints were sampled; run tracker-sampling again"
    off = beyond(Q, sampled)
    if not off.any():
        return None
    worst, j = np.unravel_index(int(np.argmax(np.abs(off))), off.shape)
    rows = sorted({numbers[int(k)] for k in np.flatnonzero(off.any(axis=1))})
    listed = ", ".join(map(str, rows))
    return (
        f"the joints of target{'s' if len(rows) > 1 else ''} {listed} are outside what the calibration "
        f"sampled, joint {j + 1} of target {numbers[int(worst)]} by {abs(off[worst, j]):.3f} rad: what it "
        "states of its predictions does not hold there"
    )


def is_outside(q: Array, sampled: Array | None) -> bool:
    """Whether joints ``q`` (j,) were not sampled, or nothing says that they were."""
    return sampled is None or bool(beyond(q, sampled).any())


def _array(rows: Any) -> Array | None:
    return None if rows is None else np.array(rows, dtype=float)
