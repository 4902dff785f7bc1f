"""How far off camera and arm will be where a task needs them, as the adjustment that found both has it.

At given joints the camera locates a point. Errors of the arm and of the camera's pose move it, and they are
not independent: what the arm errs by there was partly taken up by the camera's pose. Both come from one
covariance, so their common part counts once.
"""

from dataclasses import dataclass

import numpy as np

from calibration.adjustment.arm_accuracy import arm_numbers, flange_errors, symmetric_root
from calibration.adjustment.hand_eye import Adjusted
from calibration.adjustment.unknowns import ArmKnown
from calibration.hand_eye import se3
from cell.poses import Array

_EXPECTED = 0.95
_DRAWS, _SEED = 20_000, 12


@dataclass(frozen=True)
class TaskAccuracy:
    """Lengths (m) that 95 % of the errors stay below: by the arm as it is ``configured``, and as
    ``corrected``."""

    configured95: float
    corrected95: float


def task_accuracy(found: Adjusted, arm: ArmKnown, q: Array, distance_m: float) -> TaskAccuracy:
    """Of a point at joints ``q`` (6,) rad.

    Eye-in-hand: of the place in the base of a point that far before the camera, on its axis. Eye-to-hand: of
    the flange against the place where the camera sees it; ``distance_m`` has no meaning then. An error of the
    arm that was found is still there with the arm as configured.
    """
    part = arm_numbers(found)
    flange = arm.model.base.flange(q[None])[0]
    (error,), (columns,) = flange_errors(found, arm, q[None])  # (6,) and (6, a), in the flange
    if found.problem.setup == "eye-in-hand":
        seen = np.array([0.0, 0.0, distance_m])
        from_flange = found.X[:3, :3] @ seen + found.X[:3, 3]
        place = np.concatenate([np.eye(3), -se3.hat(from_flange)], axis=1)
    else:
        seen = (se3.inverse(found.X) @ flange)[:3, 3]
        place = np.concatenate([-flange[:3, :3], np.zeros((3, 3))], axis=1)
    of_arm = place @ columns
    of_camera = found.X[:3, :3] @ np.concatenate([np.eye(3), -se3.hat(seen)], axis=1)
    mixed = of_camera @ found.cross[:, part] @ of_arm.T
    cov = of_camera @ found.cov @ of_camera.T + of_arm @ found.cov_numbers[part, part] @ of_arm.T
    z = np.random.default_rng(_SEED).normal(size=(3, _DRAWS))
    drawn = symmetric_root(cov + mixed + mixed.T) @ z

    def below(off: Array) -> float:
        return float(np.quantile(np.linalg.norm(off[:, None] + drawn, axis=0), _EXPECTED))

    return TaskAccuracy(below(place @ error), below(np.zeros(3)))
