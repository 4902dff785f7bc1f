"""Which cone tells most: with a second distance, a rolled second lap, another branch, as far as reached."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from calibration.planning.cone import ConeShape
from calibration.planning.plan import ConePlan
from calibration.planning.planner import Checker, ConeRequest, Describer, plan_cone
from cell.arm_model import ArmModel

_FARTHER = 1.4  # of the distance: parts focal length and printed size, and is still within most reaches
_ROLLS = (0.5 * np.pi, -0.5 * np.pi, np.pi)
_FEWEST = 3  # poses that determine anything
_WORTH = 0.97  # a change that tells less than this better is not worth its way

Expected = Callable[[ConePlan], float]
"""The error (m) that is expected after a plan; smaller is better."""


def plan_telling_cone(
    request: ConeRequest,
    model: ArmModel,
    checker: Checker,
    expected: Expected,
    describe: Describer | None = None,
) -> ConePlan:
    """The plan of :func:`plan_cone`, changed step by step while the expected error falls and no pose is lost.

    A second distance that is given in ``request.shape`` is kept.
    """
    best, shape = plan_cone(request, model, checker, describe), request.shape
    if len(best.poses) < _FEWEST:
        return best
    error, tried = expected(best), best.candidates_tried
    for alternatives in _changes(shape):
        found = []
        for change in alternatives:
            other = change(shape)
            plan = plan_cone(replace(request, shape=other, axes=[best.axis]), model, checker, describe)
            tried += 1
            if len(plan.poses) >= len(best.poses):
                found.append((expected(plan), plan, other))
        if found and (least := min(found, key=lambda f: f[0]))[0] < _WORTH * error:
            error, best, shape = least
    return replace(best, candidates_tried=tried)


_Change = Callable[[ConeShape], ConeShape]


def _changes(shape: ConeShape) -> Sequence[Sequence[_Change]]:
    """What is tried one after the other; of alternatives the best is taken."""
    near, far = shape.distance_m / _FARTHER, shape.distance_m * _FARTHER
    distances: list[_Change] = [_at_two(far), _at_two(near)]
    rolls: list[_Change] = [_rolled(roll) for roll in _ROLLS]
    branch: list[_Change] = [lambda shape: replace(shape, other_branch=True)]
    return [rolls, branch] if shape.second_distance_m is not None else [distances, rolls, branch]


def _at_two(second: float) -> _Change:
    return lambda shape: replace(shape, second_distance_m=second)


def _rolled(roll: float) -> _Change:
    return lambda shape: replace(shape, roll_rad=roll)
