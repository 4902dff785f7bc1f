"""What is adjusted: an arm's parameters and the places of the reflectors, with what is known of them before.

The tracker's registration is the last six unknowns of every system of equations; it has no prior.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calibration.adjustment.arm_terms import arm_prior
from calibration.kinematics.chain import Walk
from calibration.kinematics.families import ArmSpec
from calibration.kinematics.parametric import Kind, ParametricArm
from cell.poses import Array

REGISTRATION = 6  # a turn about base x, y, z and a shift along them
LENGTH_M, ANGLE_RAD, RATIO = 0.02, 0.02, 0.02  # without a prior: far beyond what arms differ from drawings
UNKNOWN_TOOL_M = 1.0
Targets = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Model:
    """``names``, ``kinds``, ``nominal`` and ``sd`` (p,) of all parameters: the arm's, then three per target.

    ``sd`` is the prior standard deviation (m, rad, ratio). ``error_sd`` (rad) is that of the joints' errors,
    by kind, which are added where readings show them. ``unknown_tools`` are targets without a place.
    """

    arm: ParametricArm
    targets: tuple[str, ...]
    names: tuple[str, ...]
    kinds: tuple[Kind, ...]
    nominal: Array
    sd: Array
    error_sd: Mapping[str, float]
    unknown_tools: tuple[str, ...] = ()

    @property
    def size(self) -> int:
        """Number of parameters, registration not counted."""
        return len(self.names)

    @property
    def geometric(self) -> NDArray[np.bool_]:
        """(p,): which parameters are not those of joint errors."""
        out = np.ones(self.size, dtype=bool)
        out[self.arm.geometric : len(self.arm.names)] = False
        return out

    def without_errors(self) -> "Model":
        """With the parameters of geometry and targets alone."""
        kept = np.flatnonzero(self.geometric)
        return replace(
            self,
            arm=self.arm.without_errors(),
            names=tuple(self.names[k] for k in kept),
            kinds=tuple(self.kinds[k] for k in kept),
            nominal=self.nominal[kept],
            sd=self.sd[kept],
        )

    def tools(self, x: Array) -> Array:
        """(t, 3): the places of the targets on the last frame, m."""
        return np.asarray(x[len(self.arm.names) :]).reshape(-1, 3)

    def tool_rows(self) -> NDArray[np.int64]:
        """Which parameters are places of targets."""
        return np.arange(len(self.arm.names), self.size)

    def walk(self, x: Array, Q: Array) -> Walk:
        return self.arm.chain(x[: len(self.arm.names)]).walk(Q)

    def points(self, x: Array, Q: Array, target: Targets) -> Array:
        """(3, n): where the reflectors are in the base."""
        return self.walk(x, Q).point(self.tools(x)[target].T)

    def linearised(self, x: Array, Q: Array, target: Targets) -> tuple[Array, Array]:
        """Points (3, n) in the base, and the derivatives (p + 6, 3, n) of what is predicted there.

        The last six are those of ``-w x f - v``: the tracker's readings, brought to the base, move by
        ``w x f + v`` when the registration changes.
        """
        n, own = len(Q), len(self.arm.names)
        walk = self.walk(x, Q)
        f = walk.point(self.tools(x)[target].T)
        J = np.empty((self.size + REGISTRATION, 3, n))
        self.arm.columns(Q, walk, f, out=J[:own])
        axes = (walk.x[-1], walk.y[-1], walk.z[-1])
        for k in range(len(self.targets)):
            mine = 1.0 if len(self.targets) == 1 else (target == k)
            for axis in range(3):
                np.multiply(axes[axis], mine, out=J[own + 3 * k + axis])
        turn, shift = J[self.size : self.size + 3], J[self.size + 3 :]
        turn[0, 0], turn[0, 1], turn[0, 2] = 0.0, f[2], -f[1]
        turn[1, 0], turn[1, 1], turn[1, 2] = -f[2], 0.0, f[0]
        turn[2, 0], turn[2, 1], turn[2, 2] = f[1], -f[0], 0.0
        shift[:] = -np.eye(3)[:, :, None]
        return f, J


def make_model(spec: ArmSpec, targets: Sequence[str]) -> Model:
    """The model of a ROBOT for the ``targets`` that the samples name."""
    places, sds, unknown, names = [], [], [], []
    prior, usual = spec.prior, arm_prior(spec.prior)
    length = prior.length_m or LENGTH_M
    for target in targets:
        place = spec.tools.get(target)
        if place is None:
            unknown.append(target)
        places.append(np.zeros(3) if place is None else place)
        sds.append(np.full(3, UNKNOWN_TOOL_M if place is None else length))
        own = target == spec.tool_in_parameters
        names += [f"t{axis}" if own else f"{target}.{axis}" for axis in "xyz"]
    sd: Mapping[Kind, float] = {
        "length": length,
        "angle": prior.angle_rad or ANGLE_RAD,
        "ratio": prior.ratio or RATIO,
    }
    arm = spec.arm
    own_sd = np.array([sd[kind] for kind in arm.kinds])
    ratios = np.array([kind == "ratio" for kind in arm.kinds])
    size = np.abs(arm.nominal)
    own_sd[ratios] *= np.where(size[ratios] > 0.0, size[ratios], 1.0)
    lengths: list[Kind] = ["length" for _ in names]
    return Model(
        arm=arm,
        targets=tuple(targets),
        names=(*arm.names, *names),
        kinds=(*arm.kinds, *lengths),
        nominal=np.concatenate([arm.nominal, *places]),
        sd=np.concatenate([own_sd, *sds]),
        error_sd={"gear": usual.gear, "sag": usual.sag},
        unknown_tools=tuple(unknown),
    )
