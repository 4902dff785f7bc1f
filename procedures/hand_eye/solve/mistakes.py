"""What is most often given wrongly in a capture, each undone in turn: the one that makes the data agree.

A mistake is only named when the data agree without it, as flange poses and images of a true set do.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from calibration.hand_eye.closed_form import closed_form_X
from calibration.hand_eye.leave_out import spread_about_mean
from calibration.hand_eye.problem import Problem, Setup
from calibration.hand_eye.solution import Measurements, prepare
from calibration.kinematics.parametric import ParametricArm
from cell.devices import Intrinsics
from cell.poses import Array
from procedures.hand_eye.solve.joint_zero import CODE as ZERO
from procedures.hand_eye.solve.joint_zero import joint_zero
from procedures.hand_eye.solve.other_order import other_orders
from procedures.hand_eye.solve.other_writing import INVERTED, SWAPPED, TIME, UNITS_T, Mistake, other_readings
from procedures.hand_eye.solve.target_size import length_factor, sized

SCALE = "target.scale"
MIRRORED = "target.mirrored"
_MOST = 150  # observations that are looked at
_AGREE_T, _AGREE_R = 0.02, 0.02  # of the distance to the target; rad: a bad arm and lens leave less
_ALIKE = 1.5  # two explanations whose residuals differ by less are equally good; the first one is named
_SCALE_OFF = 0.02  # a target that is wrong by less does not make arm and images disagree
_NEAR_POWER = 0.1  # of a factor of 1000 that is meant, as the target may be wrong too


@dataclass(frozen=True)
class GivenCapture:
    """A capture as it was given: ``poses`` (n, 6) as they are written, ``arm`` with joints ``Q`` (n, j) when
    the flange's poses are theirs, ``size`` of the images in pixels."""

    measured: Measurements
    camera: Intrinsics | None
    poses: Array
    arm: ParametricArm | None = None
    Q: Array | None = None
    size: tuple[int, int] | None = None


def explained(given: GivenCapture) -> Mistake | None:
    """The mistake without which the data agree best; None when they agree without none of them."""
    given = _some(given)
    best: tuple[float, Mistake] | None = None
    for mistake, measured in _undone(given):
        left = _disagreement(prepare(measured, given.camera))
        if left < 1.0 and (best is None or _ALIKE * left < best[0]):
            best = left, mistake
    return None if best is None else best[1]


def _some(given: GivenCapture) -> GivenCapture:
    """The first observations: in their order, which may be what is wrong."""
    m, n = given.measured, _MOST
    _, group = np.unique(m.group[:n], return_inverse=True)
    part = replace(m, F=m.F[:n], group=group.astype(np.int64), views=m.views[:n], C=m.C[:n])
    return replace(given, measured=part, poses=given.poses[:n], Q=None if given.Q is None else given.Q[:n])


def _disagreement(problem: Problem) -> float:
    """Of the target's poses with X in closed form; below one they agree."""
    t, r = spread_about_mean(problem.target_poses(closed_form_X(problem)), problem.group)
    reach = float(np.median(np.linalg.norm(problem.C[:, :3, 3], axis=1)))
    return max(float(np.median(t)) / (_AGREE_T * reach), float(np.median(r)) / _AGREE_R)


def _undone(given: GivenCapture) -> Iterator[tuple[Mistake, Measurements]]:
    yield from _frames(given)
    for mistake, F in other_readings(given.poses):
        yield mistake, replace(given.measured, F=F)
    yield from _lengths(given)
    yield from _images(given)
    problem = prepare(given.measured, given.camera)
    for words, order in other_orders(problem):
        text = f"the poses fit the images {words}; put them in the order of the images"
        yield Mistake(TIME, text), replace(given.measured, F=given.measured.F[order])
    if given.arm is not None and given.Q is not None:
        found = joint_zero(problem, given.arm, given.Q)
        if found is not None:
            yield Mistake(ZERO, found.text), replace(given.measured, F=found.flange)


def _frames(given: GivenCapture) -> Iterator[tuple[Mistake, Measurements]]:
    """Frames that were exchanged. Inverted poses and the other setup are the same numbers: only joints part
    them, and then the poses were compared with the joints before."""
    setup: Setup = "eye-to-hand" if given.measured.setup == "eye-in-hand" else "eye-in-hand"
    if given.arm is not None:
        swapped = Mistake(SWAPPED, f"the data fit setup {setup!r}; correct setup")
    else:
        swapped = Mistake(
            f"{INVERTED} or {SWAPPED}",
            f"the data fit setup {setup!r}, or poses that are inverted (T_flange_base, or T_target_camera): "
            "without robot and joints the two cannot be told apart; correct setup, or invert the poses",
        )
    yield swapped, replace(given.measured, setup=setup)


def _lengths(given: GivenCapture) -> Iterator[tuple[Mistake, Measurements]]:
    """A target, or an arm, in another unit or of another size."""
    problem = prepare(given.measured, given.camera)
    factor = length_factor(problem)
    if factor is None or abs(factor - 1.0) < _SCALE_OFF:
        return
    if abs(np.log(factor / 1e-3)) < _NEAR_POWER:
        text = "the lengths of target or T_camera_target are in millimetres; divide them by 1000"
        mistake = Mistake(UNITS_T, text)
    else:
        text = (
            f"the data fit a target {factor:.3f} times as large; measure it over many squares and correct "
            "its lengths"
        )
        mistake = Mistake(SCALE, text)
    yield mistake, sized(given.measured, factor)


def _images(given: GivenCapture) -> Iterator[tuple[Mistake, Measurements]]:
    """Images that are mirrored."""
    if given.size is None or all(v is None for v in given.measured.views):
        return
    last = np.array([given.size[0] - 1.0, 0.0])
    views = [
        None if v is None else replace(v, corners=last + v.corners * (-1.0, 1.0), start=None)
        for v in given.measured.views
    ]
    text = "the images are mirrored; switch the camera's mirror off, or mirror them back"
    yield Mistake(MIRRORED, text), replace(given.measured, views=views)
