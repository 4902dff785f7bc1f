"""Which cone tells most: a second distance, rolled and steeper laps, other branches, as far as reached."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from calibration.planning.cone import ConeShape
from calibration.planning.plan import ConePlan
from calibration.planning.planner import Checker, ConeRequest, judged_once, plan_cone
from cell.arm_model import ArmModel

_FARTHER = 1.4  # of the distance: parts focal length and printed size, and is still within most reaches
# Laps with the roll from one to the next.
_ROLLS = ((4, 0.5 * np.pi), (2, 0.5 * np.pi), (2, -0.5 * np.pi), (2, np.pi))
_STEEPER = (1.3, 1.6)  # times the half angle: a board that is seen at an angle tells of the focal length
_FEWEST = 3  # poses that determine anything
_WORTH = 0.97  # a change that tells less than this better is not worth its way
_KEPT = 0.9  # of the plain cone's poses: what a change may cost, if what is left still tells more

Expected = Callable[[ConePlan], float]
"""The error (m) that is expected after a plan; smaller is better."""


def plan_telling_cone(
    request: ConeRequest,
    model: ArmModel,
    checker: Checker,
    expected: Expected,
) -> ConePlan:
    """The plan of :func:`plan_cone`, changed step by step while the expected error falls.

    A change may cost one pose in ten: the error is that of the poses that are left. A second distance that is
    given in ``request.shape`` is kept.
    """
    checker = judged_once(checker)
    best, shape = plan_cone(request, model, checker), request.shape
    if len(best.poses) < _FEWEST:
        return best
    error, tried = expected(best), best.candidates_tried
    enough = max(_KEPT * len(best.poses), _FEWEST)
    for alternatives in _changes(shape):
        found = []
        for change in alternatives:
            other = change(shape)
            plan = plan_cone(replace(request, shape=other, axes=[best.axis]), model, checker)
            tried += 1
            if len(plan.poses) >= enough:
                found.append((expected(plan), plan, other))
        if found and (least := min(found, key=lambda f: f[0]))[0] < _WORTH * error:
            error, best, shape = least
    return replace(best, candidates_tried=tried)


_Change = Callable[[ConeShape], ConeShape]


def _changes(shape: ConeShape) -> Sequence[Sequence[_Change]]:
    """What is tried one after the other; of alternatives the best is taken."""
    near, far = shape.distance_m / _FARTHER, shape.distance_m * _FARTHER
    distances: list[_Change] = [_at_two(far), _at_two(near)]
    rolls: list[_Change] = [_rolled(laps, roll) for laps, roll in _ROLLS]
    steeper: list[_Change] = [_steeper(factor) for factor in _STEEPER]
    branch: list[_Change] = [_on_other_branches]
    given = shape.second_distance_m is not None
    return [*([] if given else [distances]), rolls, steeper, branch]


def _at_two(second: float) -> _Change:
    return lambda shape: replace(shape, second_distance_m=second)


def _rolled(laps: int, roll: float) -> _Change:
    return lambda shape: replace(shape, laps=laps, roll_rad=roll)


def _steeper(factor: float) -> _Change:
    return lambda shape: replace(shape, laps=max(shape.laps, 2), steeper_rad=factor * shape.half_angle_rad)


def _on_other_branches(shape: ConeShape) -> ConeShape:
    return replace(shape, laps=max(shape.laps, 2), other_branch=True)
