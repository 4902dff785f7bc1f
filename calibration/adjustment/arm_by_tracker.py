"""What a laser tracker tells of an arm's numbers, for an adjustment that has them as unknowns.

Where the tracker stands and where the reflectors sit on the flange are unknown and are eliminated (Schur
complement); motions of base and flange that the numbers contain go with them, so nothing is lost that a
tracker could tell.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.adjustment.arm_about import ArmAbout
from calibration.adjustment.equations import Observations, Prior, equations
from calibration.adjustment.unknowns import ArmKnown, arm_terms
from calibration.hand_eye import se3
from calibration.hand_eye.normal import pseudo_inverse
from calibration.identification.registration import register
from cell.poses import Array

FEWEST_PLACES = 10
_STEPS = 15


@dataclass(frozen=True)
class SeenArm:
    """Curvature ``information`` (a, a) and gradient ``pull`` (a,) of the arm's numbers, at zero, their prior
    left out; the curvature is that about the numbers which the tracker's places show."""

    information: Array
    pull: Array


def seen_arm(arm: ArmKnown, places: Array, reflector: NDArray[np.int64], sigma: Array) -> SeenArm:
    """From ``places`` (n, 3) m in the tracker at the joints of ``arm``, each of the ``reflector`` (n,) with
    this number, with standard deviations ``sigma`` (n,) m per axis."""
    prior = np.concatenate([t.sigma for t in arm_terms(arm, arm.Q[:1]).values()])
    count = int(reflector.max()) + 1
    own = np.eye(count)[reflector]  # which reflector each place is of
    tracker, on_flange = np.eye(4), np.zeros((count, 3))
    a, sizes = len(prior), np.append(prior, np.full(3 * count + 6, np.inf))
    following = np.zeros(a)
    for _ in range(_STEPS):
        numbers = following
        about = ArmAbout(arm, numbers)
        moved, columns = about.true_flange(arm.Q), about.true_columns(arm.Q)
        p = (moved[:, :3, :3] @ on_flange[reflector][..., None])[..., 0] + moved[:, :3, 3]
        if not numbers.any():  # the place of the tracker, from where the reflectors are so far
            found = register(places.T, p.T, np.ones(len(p)))
            tracker[:3, :3], tracker[:3, 3] = found.R, found.b
        seen = p @ tracker[:3, :3].T + tracker[:3, 3]
        R = tracker[:3, :3] @ moved[:, :3, :3]
        by_number = R @ (columns[:, :3] - se3.hat(on_flange[reflector]) @ columns[:, 3:])
        by_flange = (R[:, :, None, :] * own[:, None, :, None]).reshape(len(p), 3, 3 * count)
        by_tracker = np.concatenate([np.broadcast_to(np.eye(3), (len(p), 3, 3)), -se3.hat(seen)], axis=2)
        J = np.concatenate([by_number, by_flange, by_tracker], axis=2) / sigma[:, None, None]
        obs = Observations.of_sums(J.reshape(3 * len(p), -1).T, ((seen - places) / sigma[:, None]).ravel())
        around = np.append(numbers, np.zeros(3 * count + 6))
        x, _ = equations(obs, np.zeros((0, 1, 1)), 1.0, Prior(0.0 * around, sizes, {}), around).step()
        following = numbers + x[:a]
        on_flange = on_flange + x[a:-6].reshape(count, 3)
        tracker = se3.exp(x[-6:]) @ tracker
    return _of_arm(obs, numbers)


def _of_arm(obs: Observations, numbers: Array) -> SeenArm:
    """What ``obs``, linearised at ``numbers`` (a,), say of these when all other unknowns follow them."""
    a = len(numbers)
    follows = obs.info[:a, a:] @ pseudo_inverse(obs.info[None, a:, a:])[0]
    information = obs.info[:a, :a] - follows @ obs.info[a:, :a]
    return SeenArm(information, information @ numbers - obs.pull[:a] + follows @ obs.pull[a:])
