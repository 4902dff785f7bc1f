"""How far an arm's flange is from where its model has it, over all its joints: from the adjustment alone.

A shift of base or flange as a whole is no error of the arm and is left out, as in its terms. At each joint
vector of the reference the expected square is that of the error found plus its variance; with the error
corrected the variance alone is left.
"""

from dataclasses import dataclass

import numpy as np

from calibration.adjustment.arm_terms import reference_joints
from calibration.adjustment.hand_eye import GEARS, GEOMETRY, Adjusted, ArmKnown, arm_terms
from cell.poses import Array

_EXPECTED = 0.95


@dataclass(frozen=True)
class FlangeError:
    """Of the flange: root mean square error in m and rad, and the position's 95 % over the joints in m."""

    t: float
    r: float
    t95: float


@dataclass(frozen=True)
class ArmAccuracy:
    """``configured``: of the arm by its model; ``corrected``: with all that was found taken off."""

    configured: FlangeError
    corrected: FlangeError


def arm_accuracy(found: Adjusted, arm: ArmKnown) -> ArmAccuracy:
    """Over the reference joints, which are spread over all that the arm can reach."""
    Q = reference_joints(arm.limits)
    columns = np.concatenate([terms.columns for terms in arm_terms(arm, Q).values()], axis=2)
    part = slice(found.blocks[GEOMETRY].start, found.blocks[GEARS].stop)
    error = columns @ found.numbers[part]
    variance = np.einsum("kip,pq,kiq->ki", columns, found.cov_numbers[part, part], columns, optimize=True)
    return ArmAccuracy(_spread(error**2 + variance), _spread(variance))


def _spread(squares: Array) -> FlangeError:
    """Of expected squares (k, 6), position first."""
    t, r = squares[:, :3].sum(axis=1), squares[:, 3:].sum(axis=1)
    return FlangeError(
        float(np.sqrt(t.mean())), float(np.sqrt(r.mean())), float(np.sqrt(np.quantile(t, _EXPECTED)))
    )
