"""Six small moves that find a first hand-eye pose when none is configured."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from calibration.planning.planner import Checker
from cell.arm_model import ArmModel
from cell.errors import CellError, error
from cell.poses import Array

MAX_SHIFT_M = 0.03
MAX_TURN_RAD = np.radians(8.0)
MIN_MOVES = 4
_SCALES = (1.0, 0.6, 0.35)

# Turn axis and shift direction in the flange frame. Turning about +x swings the view towards -y, so the shift
# goes to +y, and so on: whatever is ahead of the flange stays nearer to the middle of the image.
_MOVES = (
    ((1, 0, 0), (0, 1, 0)),
    ((0, 1, 0), (-1, 0, 0)),
    ((0, 0, 1), (0, 0, -1)),
    ((-1, 0, 0), (0, -1, 0)),
    ((0, -1, 0), (1, 0, 0)),
    ((0, 0, -1), (0, 0, 0)),
)


@dataclass(frozen=True, eq=False)
class SearchMove:
    """Joints (6,) rad and flange pose of one small move."""

    q: Array
    T_base_flange: RigidTransform


def search_moves(
    model: ArmModel, checker: Checker, q_start: Array, T_base_flange: RigidTransform | None = None
) -> list[SearchMove]:
    """Up to six moves, each at most 30 mm and 8 degrees from the start pose, turning about all axes.

    The way from each to the next, and from the last back to the start, is checked; a blocked move is tried
    smaller, then left out. ``PLAN_INFEASIBLE`` when fewer than four remain or they turn about one axis only.
    """
    start = model.forward(q_start) if T_base_flange is None else T_base_flange
    found: list[SearchMove] = []
    blocked: list[str] = []
    turned: list[tuple[int, int, int]] = []
    for turn, shift in _MOVES:
        here = found[-1].q if found else q_start
        move = _first_free(
            model, checker, start, here, q_start, np.array(turn, float), np.array(shift, float)
        )
        if isinstance(move, str):
            blocked.append(move)
        else:
            found.append(move)
            turned.append(turn)
    axes = {tuple(abs(c) for c in turn) for turn in turned}
    if len(found) < MIN_MOVES or len(axes) < 2:
        raise error(
            "PLAN_INFEASIBLE", f"{len(found)} of six search moves are free: {'; '.join(sorted(set(blocked)))}"
        )
    return found


def _first_free(
    model: ArmModel,
    checker: Checker,
    start: RigidTransform,
    here: Array,
    q_start: Array,
    turn: Array,
    shift: Array,
) -> SearchMove | str:
    """The largest free version of a move, or why there is none."""
    reason = "out of the arm's reach or joint range"
    for scale in _SCALES:
        move = RigidTransform.from_components(
            scale * MAX_SHIFT_M * shift, Rotation.from_rotvec(scale * MAX_TURN_RAD * turn)
        )
        q = model.inverse(start * move, here)
        if q is None:
            continue
        try:
            checker(here, q)
            checker(q, q_start)
        except CellError as exc:
            reason = exc.detail
            continue
        return SearchMove(q, start * move)
    return reason
