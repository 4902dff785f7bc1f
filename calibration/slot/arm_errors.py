"""What an arm errs by at the look and at the insertion: numbers of its model that are known to a prior.

A calibration says how far the arm is off the model in use: what it left on readings that were held out, or
what a hand-eye's adjustment found of the arm as it is configured. The prior then says in which proportion the
arm's numbers share that.
"""

from dataclasses import dataclass

import numpy as np

from calibration.adjustment.arm_accuracy import position_metric
from calibration.adjustment.arm_terms import arm_prior
from calibration.adjustment.unknowns import ArmKnown, arm_terms
from calibration.kinematics.families import arm_spec
from cell.formats.robot import Robot
from cell.poses import Array


@dataclass(frozen=True)
class ArmErrors:
    """``columns`` (n, 6, p): the flange's twist at each of n joint vectors for a unit of each number; ``cov``
    (p, p) of the numbers; ``rms_m``: the error of the flange's place over all that the arm can reach."""

    columns: Array
    cov: Array
    rms_m: float


def arm_errors(robot: Robot, Q: Array, rms_m: float | None) -> ArmErrors:
    """At joints ``Q`` (n, 6) rad; ``rms_m`` as a calibration found it, None without one."""
    spec = arm_spec(robot)
    known = ArmKnown(spec.arm, Q, np.tile([-np.pi, np.pi], (6, 1)), arm_prior(robot.prior))
    terms = arm_terms(known, Q).values()
    columns = np.concatenate([t.columns for t in terms], axis=2)
    cov = np.diag(np.concatenate([t.sigma for t in terms]) ** 2)
    usual = float(np.sqrt(np.sum(position_metric(known) * cov)))
    share = 1.0 if rms_m is None else rms_m / usual
    return ArmErrors(columns, share**2 * cov, share * usual)
