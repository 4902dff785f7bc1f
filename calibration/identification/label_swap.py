"""Whether readings bear the name of the reflector that they are of: two on a flange are easily mixed up."""

import numpy as np
from scipy.optimize import linear_sum_assignment

from calibration.identification.estimator import Fit, Problem
from calibration.identification.model import Model
from cell.poses import Array

_ANOTHERS = 0.1  # of its distance from where its own name puts a reading
_CLOSER = 0.25  # of the squares: names that fit the drawing so much better in another order are exchanged


def reads_like(problem: Problem, fit: Fit, row: int) -> str | None:
    """The reflector that reading ``row`` fits instead of its own; None when it fits none."""
    model, targets = problem.model, np.arange(len(problem.model.targets))
    f = model.points(fit.x, np.repeat(problem.Q[row : row + 1], len(targets), axis=0), targets)
    off = np.linalg.norm(fit.registration.to_base(problem.p[:, row : row + 1]) - f, axis=0)
    best = int(np.argmin(off))
    return model.targets[best] if off[best] < _ANOTHERS * off[problem.target[row]] else None


def exchanged(model: Model, x: Array) -> list[tuple[str, str]]:
    """Pairs of a name and the reflector in whose nominal place parameters ``x`` (p,) have it; none mostly.

    What all places have in common is left out: it may as well be the arm's last link.
    """
    names = [name for name in model.targets if name not in model.unknown_tools]
    rows = [model.targets.index(name) for name in names]
    if len(rows) < 2:
        return []
    nominal, found = (model.tools(at)[rows] for at in (model.nominal, x))
    nominal, found = nominal - nominal.mean(axis=0), found - found.mean(axis=0)
    away = np.sum((found[:, None] - nominal[None]) ** 2, axis=2)
    own, other = linear_sum_assignment(away)
    if away[own, other].sum() > _CLOSER * np.trace(away):
        return []
    return [(names[i], names[j]) for i, j in zip(own, other, strict=True) if i != j]
