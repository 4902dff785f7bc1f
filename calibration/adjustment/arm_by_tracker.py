"""What a laser tracker tells of an arm's numbers, for an adjustment that has them as unknowns.

Where the tracker stands and where the reflectors sit on the flange are unknown and are eliminated (Schur
complement); motions of base and flange that the numbers contain go with them, so nothing is lost that a
tracker could tell.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.adjustment.unknowns import ArmKnown, arm_terms
from calibration.hand_eye import se3
from cell.poses import Array

FEWEST_PLACES = 10
_STEPS = 15


@dataclass(frozen=True)
class SeenArm:
    """Curvature ``information`` (a, a) and gradient ``pull`` (a,) of the arm's numbers, at zero, their prior
    left out."""

    information: Array
    pull: Array


def seen_arm(arm: ArmKnown, places: Array, reflector: NDArray[np.int64], sigma: Array) -> SeenArm:
    """From ``places`` (n, 3) m in the tracker at the joints of ``arm``, each of the ``reflector`` (n,) with
    this number, with standard deviations ``sigma`` (n,) m per axis."""
    terms = arm_terms(arm, arm.Q)
    columns = np.concatenate([t.columns for t in terms.values()], axis=2)
    prior = np.concatenate([t.sigma for t in terms.values()])
    F = arm.model.base.flange(arm.Q)
    count = int(reflector.max()) + 1
    own = np.eye(count)[reflector]  # which reflector each place is of
    tracker, on_flange = np.eye(4), np.zeros((count, 3))
    numbers = np.zeros(len(prior))
    weight = np.repeat(1.0 / sigma, 3)
    for _ in range(_STEPS):
        moved = F @ se3.exp(columns @ numbers)
        p = (moved[:, :3, :3] @ on_flange[reflector][..., None])[..., 0] + moved[:, :3, 3]
        if not numbers.any():  # the place of the tracker, from where the reflectors are so far
            tracker = _fitted(p, places)
        seen = p @ tracker[:3, :3].T + tracker[:3, 3]
        R = tracker[:3, :3] @ moved[:, :3, :3]
        by_number = R @ (columns[:, :3] - se3.hat(on_flange[reflector]) @ columns[:, 3:])
        by_flange = (R[:, :, None, :] * own[:, None, :, None]).reshape(len(p), 3, 3 * count)
        by_tracker = np.concatenate([np.broadcast_to(np.eye(3), (len(p), 3, 3)), -se3.hat(seen)], axis=2)
        of_places = np.concatenate([by_flange, by_tracker], axis=2).reshape(3 * len(p), -1)
        A = of_places * weight[:, None]
        J = by_number.reshape(3 * len(p), -1) * weight[:, None]
        r = (places - seen).ravel() * weight
        basis, _ = np.linalg.qr(A)
        J_free, r_free = J - basis @ (basis.T @ J), r - basis @ (basis.T @ r)
        information = J_free.T @ J_free
        pull = J_free.T @ (r_free + J_free @ numbers)
        following = np.linalg.solve(information + np.diag(prior**-2.0), pull)
        step, *_ = np.linalg.lstsq(A, r - J @ (following - numbers), rcond=None)
        on_flange = on_flange + step[: 3 * count].reshape(count, 3)
        tracker = se3.exp(step[3 * count :]) @ tracker
        numbers = following
    return SeenArm(information, pull)


def _fitted(p: Array, places: Array) -> Array:
    """(4, 4) that brings ``p`` (n, 3) nearest to ``places`` (n, 3); Arun, Huang and Blostein 1987."""
    mean, to = p.mean(axis=0), places.mean(axis=0)
    U, _, Vt = np.linalg.svd((places - to).T @ (p - mean))
    R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, to - R @ mean
    return T
