"""An arm as a function of its parameters: what a calibration adjusts, and the derivatives of a point.

Every parameter moves one or several numbers of a chain in proportion. Most arms have one parameter for each
number; the palletizer's parallelogram has two that move two links at once, in opposite senses.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from calibration.kinematics.chain import SerialChain, Walk, cross
from calibration.kinematics.joint_errors import JointErrors
from cell.poses import Array

Kind = Literal["length", "angle", "ratio"]


@dataclass(frozen=True, eq=False)
class ParametricArm:
    """``names``, ``kinds`` and ``nominal`` (p,) of the parameters, at which the arm is ``base``.

    The numbers that can move are, in this order, theta, d, a and alpha of all m links, beta of the links in
    ``betas`` (b,), and the entries (row, column) of the coupling in ``ratios`` (r, 2). ``mix`` (p, k) says
    how far each parameter moves each of the k numbers; None stands for one parameter per number. The last
    parameters are the amplitudes of the joint ``errors``, if there are any.
    """

    family: str
    names: tuple[str, ...]
    kinds: tuple[Kind, ...]
    nominal: Array
    base: SerialChain
    betas: NDArray[np.int64]
    ratios: NDArray[np.int64]
    mix: Array | None = None
    errors: JointErrors | None = None

    @property
    def joints(self) -> int:
        return self.base.joints

    @property
    def geometric(self) -> int:
        """How many parameters come before those of the joint errors."""
        return len(self.names) - (0 if self.errors is None else 2 * len(self.errors.names))

    def without_errors(self) -> "ParametricArm":
        """With the parameters of the geometry alone."""
        own = self.geometric
        return replace(
            self, names=self.names[:own], kinds=self.kinds[:own], nominal=self.nominal[:own], errors=None
        )

    def with_errors(self, errors: JointErrors) -> "ParametricArm":
        """With the amplitudes of ``errors`` as parameters."""
        fresh = errors.amplitudes
        angles: list[Kind] = ["angle" for _ in fresh]
        return replace(
            self,
            names=(*self.names, *fresh),
            kinds=(*self.kinds, *angles),
            nominal=np.concatenate([self.nominal, np.zeros(len(fresh))]),
            errors=errors,
        )

    def chain(self, values: Array) -> SerialChain:
        """The arm with parameters ``values`` (p,)."""
        moved = np.asarray(values, dtype=float) - self.nominal
        errors = self.base.errors
        if self.errors is not None:
            moved, amplitudes = np.split(moved, [self.geometric])
            errors = self.errors.moved(amplitudes).beside(errors)
        if self.mix is not None:
            moved = moved @ self.mix
        m, base = len(self.base.theta), self.base
        beta, coupling = base.beta.copy(), base.coupling.copy()
        beta[self.betas] += moved[4 * m : 4 * m + len(self.betas)]
        coupling[self.ratios[:, 0], self.ratios[:, 1]] += moved[4 * m + len(self.betas) :]
        return replace(
            base,
            theta=base.theta + moved[:m],
            d=base.d + moved[m : 2 * m],
            a=base.a + moved[2 * m : 3 * m],
            alpha=base.alpha + moved[3 * m : 4 * m],
            beta=beta,
            coupling=coupling,
            errors=errors,
        )

    def columns(self, Q: Array, walk: Walk, p: Array, out: Array | None = None) -> Array:
        """(p, 3, n): derivatives of points ``p`` (3, n) that ride on the last frame, in the base.

        ``walk`` is that of the chain in question at ``Q`` (n, j). A turn about an axis moves a point by the
        cross product of the axis and the lever, a shift along an axis by the axis.
        """
        m, b = len(self.base.theta), len(self.betas)
        own = self.geometric
        every = out if out is not None else np.empty((len(self.names), *p.shape))
        direct = every[:own] if self.mix is None else np.empty(self._shape(p.shape[1]))
        lever = p - walk.o
        z = walk.z[:-1]
        direct[:m] = cross(z, lever[:-1])
        direct[m : 2 * m] = z
        direct[2 * m : 3 * m] = walk.turned
        direct[3 * m : 4 * m] = cross(walk.turned, lever[1:])
        if b:
            direct[4 * m : 4 * m + b] = cross(walk.y[1 + self.betas], lever[1 + self.betas])
        for k, (row, column) in enumerate(self.ratios):
            source = direct[m + row] if self.base.sliding[row] else direct[row]
            np.multiply(source, Q[:, column], out=direct[4 * m + b + k])
        if self.mix is not None:
            every[:own] = np.tensordot(self.mix, direct, axes=1)
        if self.errors is not None:
            turning = np.where(self.base.sliding[:, None, None], 0.0, direct[:m])
            per_joint = np.tensordot(self.base.coupling.T, turning, axes=1)[self.errors.joint]
            for k, waves in enumerate(self.errors.waves(Q)):
                part = slice(own + k * len(waves), own + (k + 1) * len(waves))
                np.multiply(per_joint, waves[:, None], out=every[part])
        return every

    def _shape(self, n: int) -> tuple[int, int, int]:
        return (4 * len(self.base.theta) + len(self.betas) + len(self.ratios), 3, n)
