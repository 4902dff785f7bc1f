"""A target on the flange that a fixed camera sees, and what is known of its place there.

The adjustment gives a camera's and a target's pose that serve best with the arm as it is configured. A place
on the flange that was measured or drawn belongs to the arm's true last link, and a camera's pose to its true
first one. The motions of base and flange that an arm's errors contain are put back for that, with all their
uncertainty: the less is known of an arm, the less a known place says. What was learnt there is then told for
the base that serves the arm as it is configured, which is the one that a camera's pose is used with.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from scipy.special import chdtri

from calibration.adjustment.components import Components
from calibration.adjustment.hand_eye import Adjusted
from calibration.adjustment.shared_errors import SharedErrors
from calibration.adjustment.unknowns import LENS_BLOCK, ArmKnown, arm_terms
from calibration.hand_eye import se3
from cell.poses import Array, adjoint

CHANCE = 1e-2  # of taking a value that is right for one that is not
_SURE = 7.4  # twice the logarithm of 40: one explanation is so many times as likely as the other
PLACE_DOUBTED = ("C", "cannot-tell")  # who is blamed where the target's place may be what is wrong
_X, _W = slice(0, 6), slice(6, 12)


@dataclass(frozen=True)
class Mounted:
    """``X`` (4, 4) T_base_camera, ``W`` (4, 4) T_flange_target, and the arm's ``numbers`` (a,).

    ``cov`` (12 + a, 12 + a) is that of X, W (each in its own frame, perturbation on the right) and the
    numbers. ``scale``: by which the arm's errors exceed their prior, by block. ``gauge`` (12, a): the motions
    of base (in the base) and flange (in the flange) by the numbers that are in X and W.
    """

    X: Array
    W: Array
    numbers: Array
    cov: Array
    scale: Mapping[str, float]
    gauge: Array = field(default_factory=lambda: np.zeros((12, 0)))

    @property
    def cov_X(self) -> Array:
        """(6, 6)."""
        return self.cov[_X, _X]

    @property
    def cov_W(self) -> Array:
        """(6, 6)."""
        return self.cov[_W, _W]


@dataclass(frozen=True)
class GivenPose:
    """A pose (4, 4) as it was given, and its covariance (6, 6), perturbation on the right."""

    T: Array
    cov: Array


@dataclass(frozen=True)
class Suspicion:
    """Squared Mahalanobis distances of what was given of camera and target, alone and together.

    ``X`` and ``W`` have 6 degrees of freedom, ``both`` has 12. Each is judged while the other is free.
    """

    X: float
    W: float
    both: float

    @property
    def blamed(self) -> Literal["none", "X", "C", "cannot-tell"]:
        """``none``, ``X`` (the camera), ``C`` (the target's place), or ``cannot-tell``.

        Something is wrong when giving one of them up explains far more than chance does. It is that one, when
        nothing is left to be explained, and giving up the other one does far worse.
        """
        left = min(self.X, self.W)  # giving up the target leaves the camera to be explained, and so on
        limit = float(chdtri(6, CHANCE))
        if self.both - left <= limit:
            return "none"
        if left > limit or abs(self.X - self.W) < _SURE:
            return "cannot-tell"
        return "X" if self.X > self.W else "C"


def mounted(found: Adjusted, arm: ArmKnown | SharedErrors | None) -> Mounted:
    """Of an eye-to-hand adjustment with one placement, for the true base and the true flange."""
    a = found.blocks[LENS_BLOCK].start  # the arm's numbers come first
    cross_W = found.cross_W[0]
    cov = np.block(
        [
            [found.cov, cross_W[:, :6].T, found.cross[:, :a]],
            [cross_W[:, :6], found.cov_W[0], cross_W[:, 6 : 6 + a]],
            [found.cross[:, :a].T, cross_W[:, 6 : 6 + a].T, found.cov_numbers[:a, :a]],
        ]
    )
    own = Mounted(found.X, found.W[0], found.numbers[:a], cov, dict(found.components.scale))
    return on_true_arm(own, arm, found.components)


def on_true_arm(found: Mounted, arm: ArmKnown | SharedErrors | None, components: Components) -> Mounted:
    """``found`` for an arm without the motions of base and flange that its errors contain, with them.

    ``components`` are what was found of the noise and of the arm's scale. Base and flange move linearly with
    the numbers, also where the adjustment was not linear in them.
    """
    if arm is None:
        return found
    if isinstance(arm, SharedErrors):
        own = found.numbers.size
        found = _with_numbers(found, np.concatenate(arm.ends(components.scale, components.sigma)))
        gauge = np.hstack([np.zeros((12, own)), np.eye(12)])
    else:
        gauge = np.concatenate([t.gauge for t in arm_terms(arm, arm.Q[:1]).values()], axis=1)
    return _moved(found, gauge, 1.0)


def for_controller(found: Mounted) -> Mounted:
    """``found`` with the camera in the base that serves the arm as it is configured best; the target stays on
    the true flange."""
    base = found.gauge.copy()
    base[6:] = 0.0
    return replace(_moved(found, base, -1.0), gauge=found.gauge - base)


def _with_numbers(found: Mounted, sigma: Array) -> Mounted:
    """With more numbers, which are zero with the standard deviations ``sigma`` (k,)."""
    known, count = len(found.cov), len(sigma)
    cov = np.zeros((known + count, known + count))
    cov[:known, :known] = found.cov
    cov[known:, known:] = np.diag(sigma**2)
    return replace(found, numbers=np.append(found.numbers, np.zeros(count)), cov=cov)


def _moved(found: Mounted, gauge: Array, sign: float) -> Mounted:
    """Base and flange moved by ``sign`` times what ``gauge`` (12, a) makes of the numbers."""
    X = se3.exp(sign * gauge[:6] @ found.numbers) @ found.X
    W = se3.exp(-sign * gauge[6:] @ found.numbers) @ found.W
    J = np.eye(len(found.cov))
    J[_X, 12:] = sign * adjoint(se3.inverse(X)) @ gauge[:6]
    J[_W, 12:] = -sign * adjoint(se3.inverse(W)) @ gauge[6:]
    return Mounted(X, W, found.numbers, J @ found.cov @ J.T, found.scale, gauge)


def with_place(found: Mounted, given: GivenPose) -> Mounted:
    """``found`` with the target's place on the flange known as ``given``; it says of the camera, too."""
    y = se3.log(se3.inverse(found.W) @ given.T)
    gain = np.linalg.solve(found.cov_W + given.cov, found.cov[_W]).T
    step = gain @ y
    cov = found.cov - gain @ found.cov[_W]
    return Mounted(
        found.X @ se3.exp(step[_X]),
        found.W @ se3.exp(step[_W]),
        found.numbers + step[12:],
        0.5 * (cov + cov.T),
        found.scale,
        found.gauge,
    )


def suspicion(found: Mounted, camera: GivenPose, place: GivenPose) -> Suspicion:
    """How far a given T_base_camera and a given T_flange_target are from what the images say alone."""
    y = np.concatenate([se3.log(se3.inverse(found.X) @ camera.T), se3.log(se3.inverse(found.W) @ place.T)])
    S = found.cov[:12, :12].copy()
    S[_X, _X] += camera.cov
    S[_W, _W] += place.cov
    return Suspicion(*(_distance(y[part], S[part, part]) for part in (_X, _W, slice(0, 12))))


def _distance(y: Array, S: Array) -> float:
    scale = 1.0 / np.sqrt(np.diag(S))
    return float((y * scale) @ np.linalg.solve(S * np.outer(scale, scale), y * scale))
