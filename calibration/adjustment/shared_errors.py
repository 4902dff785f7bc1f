"""Errors of flange poses that neighbouring poses share: what is known of an arm whose joints are not given.

What a robot, its base and what hangs on its flange err by changes slowly from pose to pose. Taken as noise of
each pose by itself it would average out over the poses, which it does not: the stated uncertainty was then up
to four times too small in simulations. So place and attitude of the flange, each along three axes of the
base, are off by random functions of the pose; their size follows from the data. How slowly they change is not
known: the correlation is a mixture of all lengths about the distance of poses that differ by the arm's reach
or by a right angle. A smaller part is the same in all poses along the axes of the flange, as an error of the
last joints is; where it looks like the camera's pose, or the target's, the data do not tell it.
Source: collocation, Moritz, Advanced Physical Geodesy (1980); rational quadratic covariance, Rasmussen and
Williams, Gaussian Processes for Machine Learning (2006), 4.19.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from calibration.adjustment.arm_terms import ArmPrior
from calibration.adjustment.twists import FunctionTwists
from calibration.hand_eye.normal import row_blocks
from cell.poses import Array

PLACE, ATTITUDE = "flange_t", "flange_r"
# RMS of one axis of a UR10e's flange over all its joints, with the best base and flange, in units of the
# usual error of a length and of an angle of its chain; a UR3e to a UR20 have 1.8 to 2.4, and 1.9.
_PLACE, _ATTITUDE = 2.1, 1.9
# What all poses share along the axes of the flange, in units of an axis' standard deviation: its share of the
# variance is 0 (every pose on another branch) to 0.25 of a UR10e, see decision 0047.
_ALIKE = 0.25
_KEPT = 1e-5  # share of the variance that functions beyond those kept may have
_MOST = 40  # functions, for each axis of place and attitude
_NUMBERS = 80_000  # functions times poses: the derivatives of 5000 poses then take 20 MB
_CENTRES = 300  # poses that the functions are made of


@dataclass(frozen=True)
class SharedErrors:
    """Functions of a pose: correlation with ``centres`` (k, 4, 4) times ``mixed`` (k, c); ``reach`` in m."""

    centres: Array
    reach: float
    mixed: Array
    prior: ArmPrior = field(default_factory=ArmPrior)

    @property
    def sigma(self) -> dict[str, float]:
        """Prior standard deviation of one axis: of the place (m), and of the attitude (rad)."""
        return {PLACE: _PLACE * self.prior.length, ATTITUDE: _ATTITUDE * self.prior.angle}

    def sizes(self, scale: Mapping[str, float]) -> tuple[float, float]:
        """Standard deviations of one axis, place (m) and attitude (rad), with the ``scale`` found."""
        return self.sigma[PLACE] * scale.get(PLACE, 1.0), self.sigma[ATTITUDE] * scale.get(ATTITUDE, 1.0)

    def ends(self, scale: Mapping[str, float], noise: Mapping[str, float]) -> tuple[Array, Array]:
        """Standard deviations (6,), m and rad, of motions of the true base and the true flange, each in its
        own frame, of an arm whose errors are found with this ``scale`` and ``noise`` of single poses.

        The first link's offset and zero move the base along and about its z, the numbers of the last link
        the flange along and about its x and z. Poses on different branches of the arm share hardly anything
        else, so its errors may be in the noise: all of that counts.
        """
        t, r = self.sizes(scale)
        t = float(np.hypot(t, np.linalg.norm([v for k, v in noise.items() if k.endswith("_t")]))) / _PLACE
        r = float(np.hypot(r, np.linalg.norm([v for k, v in noise.items() if k.endswith("_r")]))) / _ATTITUDE
        return np.array([0.0, 0.0, t, 0.0, 0.0, r]), np.array([t, 0.0, t, r, 0.0, r])

    def functions(self, F: Array) -> Array:
        """(n, c) at flange poses ``F`` (n, 4, 4); unlike poses share nothing, so they fall to zero there."""
        out = np.empty((len(F), self.mixed.shape[1]))
        for rows in row_blocks(len(F)):
            out[rows] = _correlation(F[rows], self.centres, self.reach) @ self.mixed
        return out

    def unexplained(self, F: Array) -> Array:
        """(n,) share of an error's variance at ``F`` (n, 4, 4) that the functions do not have."""
        return np.asarray(np.maximum(0.0, 1.0 - np.sum(self.functions(F) ** 2, axis=1)))

    def blocks(self) -> dict[str, tuple[tuple[str, ...], Array]]:
        """Names and prior standard deviations of the numbers of place and attitude."""
        count = self.mixed.shape[1]
        names = [f"{axis}.{k}" for axis in "xyz" for k in range(count)] + [f"flange.{axis}" for axis in "xyz"]
        share = np.repeat([1.0, _ALIKE], [3 * count, 3])
        return {
            block: (tuple(f"{block}.{name}" for name in names), self.sigma[block] * share)
            for block in (PLACE, ATTITUDE)
        }

    def twists(self, F: Array) -> FunctionTwists:
        """By the numbers of :meth:`blocks`, at flange poses ``F`` (n, 4, 4)."""
        return FunctionTwists(self.functions(F), F[:, :3, :3])


def shared_errors(F: Array, prior: ArmPrior | None = None) -> SharedErrors:
    """Of an arm that had its flange at ``F`` (n, 4, 4).

    The functions are the principal components of the correlation over these poses (Nystroem's method where
    they are many), as many as matter.
    """
    reach = max(float(np.sqrt(np.mean(np.sum(F[:, :3, 3] ** 2, axis=1)))), 1e-3)
    centres = F[np.unique(np.linspace(0, len(F) - 1, min(len(F), _CENTRES)).round().astype(np.int64))]
    values, vectors = np.linalg.eigh(_correlation(centres, centres, reach))
    values, vectors = values[::-1], vectors[:, ::-1]
    left = 1.0 - np.cumsum(values) / values.sum()
    count = min(int(np.count_nonzero(left > _KEPT)) + 1, _MOST, max(_NUMBERS // len(F), 1), len(centres))
    return SharedErrors(centres, reach, vectors[:, :count] / np.sqrt(values[:count]), prior or ArmPrior())


def _correlation(A: Array, B: Array, reach: float) -> Array:
    """(n, k) between errors at poses ``A`` (n, 4, 4) and ``B`` (k, 4, 4).

    A turn by a counts as ``sqrt(8/3) sin(a/2)``, which is 1.15 for a right angle.
    """
    squared = _apart(A[:, :3, 3], B[:, :3, 3]) / reach**2
    squared += _apart(A[:, :3, :3].reshape(-1, 9), B[:, :3, :3].reshape(-1, 9)) / 3.0
    return np.asarray(1.0 / (1.0 + 0.5 * squared))


def _apart(a: Array, b: Array) -> Array:
    """Squared distances (n, k) of ``a`` (n, d) and ``b`` (k, d)."""
    squared = np.sum(a**2, axis=1)[:, None] + np.sum(b**2, axis=1) - 2.0 * a @ b.T
    return np.asarray(np.maximum(squared, 0.0))
