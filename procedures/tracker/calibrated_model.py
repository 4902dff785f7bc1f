"""The arm of a result as a model that can be linearised, with the covariance of its parameters."""

import numpy as np

from calibration.identification.joint_errors import extended
from calibration.identification.model import REGISTRATION, Model, make_model
from calibration.kinematics.families import arm_spec
from cell.formats.robot import parse_robot
from cell.poses import Array
from procedures.tracker.result import KincalResult


def calibrated_model(found: KincalResult) -> Model:
    """With its targets, and its values as ``nominal``; raises an ``InputError`` for an unknown arm."""
    names = found.uncertainty.names or ()
    spec = arm_spec(parse_robot(found.result.robot, "result.robot"))
    model = make_model(spec, found.inputs.targets)
    errors = {k: sd for k, sd in model.error_sd.items() if any(n.startswith(k) for n in names)}
    return extended(model, errors) if errors else model


def covariance_of(found: KincalResult, model: Model) -> Array | None:
    """(p + 6, p + 6) in the order of ``model``; None when the result has none, or other parameters."""
    cov, names = found.uncertainty.cov, found.uncertainty.names
    if cov is None or names is None:
        return None
    own = list(model.names)
    if sorted(names[:-REGISTRATION]) != sorted(own) or len(cov) != len(names):
        return None
    order = [*(names.index(name) for name in own), *range(len(own), len(own) + REGISTRATION)]
    return np.array(cov, dtype=float)[np.ix_(order, order)]


def freedom_of(found: KincalResult) -> float:
    """Degrees of freedom that the covariance was sized with; infinite where the noise was given."""
    return found.uncertainty.degrees_of_freedom or np.inf
