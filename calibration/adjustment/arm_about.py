"""An arm's terms about numbers that were found: for errors that the flange does not follow linearly.

The derivatives of :mod:`calibration.adjustment.arm_terms` are those of the configured arm. Where an arm is
off by millimetres the products of its errors move the flange by more than its noise, and the uncertainty of
an answer without them is stated too small. Here flange and derivatives are those of the corrected arm, again
without the motions of base and flange that serve best over all joints.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calibration.adjustment.arm_terms import (
    common_motion,
    free_amplitudes,
    gears_and_sag,
    joint_errors,
    joints_to_average,
    twists,
)
from calibration.adjustment.gauge import base_and_flange
from calibration.adjustment.unknowns import ArmKnown
from calibration.hand_eye import se3
from calibration.kinematics.parametric import ParametricArm
from cell.poses import Array, adjoint


@dataclass(frozen=True)
class ArmAbout:
    """``arm`` with the ``numbers`` (a,) of its geometry and gears, those that were found so far."""

    arm: ArmKnown
    numbers: Array

    def motion(self, Q: Array) -> Array:
        """(n, 4, 4): from the flange of the configured arm at joints ``Q`` (n, j) to that of the corrected
        one, whose base and flange are where they serve best."""
        out: Array = se3.inverse(self.arm.model.base.flange(Q)) @ self.flange(Q)
        return out

    def columns(self, Q: Array) -> Array:
        """(n, 6, a): motion of the corrected flange, in its own frame, by a change of each number.

        Taken out are the base and the flange that are nearest to what a number does. The derivative of
        :attr:`ends` differs from these by what the products of errors do to it, which is left out: a motion
        of base and flange alone.
        """
        at_base = adjoint(se3.inverse(self.flange(Q))) @ self.gauge[:6]
        out: Array = self._columns(Q) - at_base - self.gauge[6:]
        return out

    def true_flange(self, Q: Array) -> Array:
        """(n, 4, 4) of the corrected arm at joints ``Q`` (n, j), with its own base and flange."""
        return self._model.base.flange(Q)

    def true_columns(self, Q: Array) -> Array:
        """(n, 6, a): motion of :meth:`true_flange`, in its own frame, by a change of each number."""
        errors = joint_errors(self.arm.model.base)
        gears = gears_and_sag(self._model.base, Q, self.arm.prior, errors).columns
        return np.concatenate([twists(self._model, Q), gears], axis=2)

    @cached_property
    def _model(self) -> ParametricArm:
        with_errors, values = arm_with(self.numbers, self.arm)
        return replace(self.arm.model, base=with_errors.chain(values))

    @cached_property
    def ends(self) -> tuple[Array, Array]:
        """``base`` and ``flange`` (4, 4): about ``base @ configured @ flange`` is the corrected arm."""
        Q = joints_to_average(self.arm.limits)
        return base_and_flange(self.arm.model.base.flange(Q), self.true_flange(Q))

    def flange(self, Q: Array) -> Array:
        """(n, 4, 4) of the corrected arm at joints ``Q`` (n, j), less base and flange that serve best."""
        base, flange = self.ends
        out: Array = se3.inverse(base) @ self.true_flange(Q) @ se3.inverse(flange)
        return out

    def _columns(self, Q: Array) -> Array:
        out: Array = adjoint(self.ends[1]) @ self.true_columns(Q)
        return out

    @cached_property
    def gauge(self) -> Array:
        """(12, a): the motions of base and flange that are taken out of the columns."""
        Q = joints_to_average(self.arm.limits)
        return common_motion(self._columns(Q), self.flange(Q))


def arm_with(numbers: Array, arm: ArmKnown) -> tuple[ParametricArm, Array]:
    """The arm with its joint errors, and the values (p,) of its numbers.

    ``numbers`` (a,) are those of its geometry and its gears in that order.
    """
    geometry, gears = np.split(numbers, [len(arm.model.names)])
    errors = joint_errors(arm.model.base)
    amplitudes = np.zeros(len(errors.amplitudes))
    amplitudes[free_amplitudes(errors)] = gears
    errors = errors.moved(amplitudes)
    base = arm.model.base
    with_errors = replace(arm.model, base=replace(base, errors=errors.beside(base.errors)))
    return with_errors, arm.model.nominal + geometry
