"""Where to send an arm so that its flange is where a fixed camera wants it, and whether that is any better.

Three ways: as the given calibration has it, with one constant motion, and through the arm's
kinematic model with its errors. Which one is used is decided by places that were not looked at: those of each
fold are predicted from the other folds. A way that is not surely better than a simpler one is not taken.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from calibration.adjustment.arm_about import arm_with
from calibration.adjustment.mount import Mounted
from calibration.adjustment.unknowns import ArmKnown
from calibration.hand_eye import se3
from cell.poses import Array

Way = Literal["none", "constant", "model"]
NONE: Way = "none"
CONSTANT: Way = "constant"
MODEL: Way = "model"
FOLDS = 5
_SURE = 2.0  # standard errors by which the squared errors must be smaller


@dataclass(frozen=True)
class CameraAndTarget:
    """A camera ``X`` (4, 4) T_base_camera and a target ``W`` (4, 4) T_flange_target."""

    X: Array
    W: Array

    def marker(self, flange: Array) -> Array:
        """(n, 4, 4) T_camera_target with the flange at (n, 4, 4)."""
        out: Array = se3.inverse(self.X) @ flange @ self.W
        return out


@dataclass(frozen=True)
class ChosenWay:
    """``cv``: RMS distance (m) of the target from where each way predicts it, unseen; ``chosen`` of them."""

    chosen: Way
    cv: dict[Way, float] = field(default_factory=dict)


def plain_mean(F: Array, C: Array, W: Array) -> Array:
    """X (4, 4): mean of what each pose says with the target's place taken as exact, ``A X B = C``."""
    return se3.mean_pose(F @ W @ se3.inverse(C))


@dataclass(frozen=True)
class Corrected:
    """The ``arm`` at the joints ``Q`` (n, 6) of n observations; ``by(rows)`` solves with some of them."""

    arm: ArmKnown
    Q: Array
    by: Callable[[NDArray[np.int64]], Mounted]


def choose(
    given: CameraAndTarget,
    F: Array,
    C: Array,
    arm: Corrected | None,
    place: Callable[[NDArray[np.int64]], Array] | None = None,
) -> ChosenWay:
    """From flange poses ``F`` and T_camera_target ``C``, (n, 4, 4); without ``arm`` there is no model.

    ``place(rows)`` is T_flange_target (4, 4) as some observations have it, where the given one is doubted:
    a place that is wrong would count as an error of each way that is judged with it.
    """
    n = len(F)
    fold = np.arange(n) % FOLDS
    seen = C[:, :3, 3]
    squared = {NONE: np.zeros(n), CONSTANT: np.zeros(n)}
    if arm is not None:
        squared[MODEL] = np.zeros(n)
    for k in range(FOLDS):
        out, rest = np.flatnonzero(fold == k), np.flatnonzero(fold != k)
        W = given.W if place is None else place(rest)
        for way, X in ((NONE, given.X), (CONSTANT, plain_mean(F[rest], C[rest], W))):
            squared[way][out] = _off(CameraAndTarget(X, W).marker(F[out]), seen[out])
        if arm is not None:
            found = arm.by(rest)
            flange = corrected_flange(found, arm.arm, arm.Q[out])
            squared[MODEL][out] = _off(CameraAndTarget(found.X, found.W).marker(flange), seen[out])
    chosen = NONE
    for way in squared:
        if _surely_less(squared[way], squared[chosen]):
            chosen = way
    return ChosenWay(chosen, {way: float(np.sqrt(s.mean())) for way, s in squared.items()})


def corrected_flange(found: Mounted, arm: ArmKnown, Q: Array) -> Array:
    """(k, 4, 4) where the arm truly has its flange at joints ``Q`` (k, 6)."""
    corrected, values = arm_with(found.numbers, arm)
    return corrected.chain(values).flange(Q)


def _off(T: Array, seen: Array) -> Array:
    return np.asarray(np.sum((T[:, :3, 3] - seen) ** 2, axis=1))


def _surely_less(squared: Array, than: Array) -> bool:
    gain = than - squared
    return len(gain) > 1 and float(gain.mean()) > _SURE * float(gain.std(ddof=1)) / np.sqrt(len(gain))
