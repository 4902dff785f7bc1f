"""From where the tool stood to what tool, camera and arm are off by: the one path of job and replay."""

import time
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform
from scipy.special import chdtrc, chdtri

from calibration.adjustment.lens_terms import LENS, TARGET, image_terms, target_prior, target_shape
from calibration.lengths import length95
from calibration.refusal import Refusal
from calibration.slot.arm_errors import arm_errors
from calibration.targets import make_target
from calibration.tool_frame.repeatability import stated_sigma
from calibration.touch import CommonMotion, PointsOff, Standing, common_motion, over_points, points_off
from cell.errors import error
from cell.formats.result import Result, Warning_
from cell.poses import Array, from_pose6, to_pose6
from procedures.solving import Progress, refused, require_no_method, within_limits
from procedures.touch_test.config import LEAST_WAY_DOWN_M
from procedures.touch_test.data import LookTaken, TouchData, located, printed_points, read_data_set, view_of
from procedures.touch_test.result import (
    CauseOff,
    CornerOff,
    TouchAnswer,
    TouchInputs,
    TouchObservability,
    TouchResiduals,
    TouchResult,
    TouchUncertainty,
)
from procedures.words import deg, mm

FEWEST = 3  # corners, not on a line
SURE = 1.0 / 300.0  # as often a cell in which nothing is off is said to be off
CORNER_PX = 0.2  # noise of a corner in a picture, where the look does not show more
BY_HAND = "point over a corner"
SIGMAS = 3.0  # of the height, within which nothing may be met
_LINE = 0.05  # of the corners' spread: one that is narrower is a line
_SAME_DIGITS = 9  # of m: causes that are no further apart than a nanometre are told by their names' order
_NOT_TOLD = (
    "which of tool, camera and arm is off: 'cellward cross-check --touch' judges it with two captures",
    "what tool, camera and arm are off by elsewhere: the test is at one board",
    "the lens, where the look is not from about as far as the hand-eye's capture was",
)


@within_limits
def solve_touch_test(
    path: Path, *, method: str | None = None, progress: Progress | None = None
) -> TouchResult | Result:
    """The result from a run's folder or its ``touch-test.json``; too soon over for any ``progress``."""
    require_no_method("touch-test", method)
    data, file = read_data_set(path)
    began = time.perf_counter()
    inputs = TouchInputs(
        path=str(file), corners=len(data.stood), skipped=data.skipped, arm_rms_m=data.arm_rms_m
    )
    if (why := _too_little(data)) is not None or data.look is None:
        return refused("touch-test", why or Refusal("not-looked", "the board was not seen"), [], inputs)
    standing, off, sources = _off(data, data.look)
    found = common_motion(standing.places, off.off)
    cov = {name: found.by_points @ one @ found.by_points.T for name, one in sources.items()}
    T_base_target = to_pose6(RigidTransform.from_matrix(standing.flange_look @ standing.X @ standing.C))
    seconds = time.perf_counter() - began
    return _result(data, off, found, cov, T_base_target, inputs.changed(solve_seconds=seconds))


def require_clearance(data: TouchData) -> None:
    """``ARGUMENT_INVALID`` where the tool's point may reach the board on its way down: ``stood`` is where it
    is to stand, and its height there is not known to a third of the stand-off (one standard deviation)."""
    if data.look is None:
        raise error("BOARD_NOT_SEEN", "there is no look yet")
    config, (_, _, sources) = data.job, _off(data, data.look)
    cov = np.asarray(sum(one for name, one in sources.items() if name != BY_HAND))
    sigma = np.sqrt(np.diag(cov)[2::3])
    k = int(np.argmax(sigma))
    if (needed := SIGMAS * float(sigma[k])) > config.stand_off_m:
        higher = " and clear_m" if needed + LEAST_WAY_DOWN_M > config.clear_m else ""
        raise error(
            "ARGUMENT_INVALID",
            f"stand_off_m is {mm(config.stand_off_m, 1)}, and the height of the tool's point over point "
            f"{data.stood[k].corner} of '{config.target}' is known to {mm(needed, 1)} only "
            f"(three standard deviations): take a thicker gauge and a larger stand_off_m{higher}, measure "
            "the board and state its scale_sigma, or calibrate the camera anew with this board",
        )


def _off(data: TouchData, look: LookTaken) -> tuple[Standing, PointsOff, dict[str, Array]]:
    """Where the tool's point stood, what it was off by there, and the covariances of that by cause."""
    printed = printed_points(data.spec, look)
    poses = located(look, printed)
    standing, off = _points(data, look, printed, poses.C[0])
    px = max(CORNER_PX, float(np.sqrt(poses.sse[0] / max(2 * poses.corners[0] - 6, 1))))
    sources = _sources(data, look, off, px**2 * poses.cov[0])
    by_board = _by_board(look, printed, standing, off)
    return standing, off, sources | {"board": by_board @ _board_cov(data, look) @ by_board.T}


def points_of(data: TouchData, look: LookTaken) -> tuple[Standing, PointsOff]:
    """Where the tool's point stood, and what it was off by there."""
    printed = printed_points(data.spec, look)
    return _points(data, look, printed, located(look, printed).C[0])


def _points(data: TouchData, look: LookTaken, printed: Array, C: Array) -> tuple[Standing, PointsOff]:
    F_look, X = from_pose6(look.T_base_flange).as_matrix(), from_pose6(data.T_flange_camera).as_matrix()
    flange = np.array([from_pose6(at.T_base_flange).as_matrix() for at in data.stood])
    places = over_points(printed[[at.corner for at in data.stood]], C, data.job.stand_off_m)
    standing = Standing(F_look, flange, X, C, np.array(data.tool), places)
    return standing, points_off(standing)


def _too_little(data: TouchData) -> Refusal | None:
    if len(data.stood) < FEWEST:
        text = f"the tool's point stood over {len(data.stood)} corners, {FEWEST} are needed"
        return Refusal("too-few-corners", text)
    points = make_target(data.spec).points[[at.corner for at in data.stood]]
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if spread[1] < _LINE * spread[0]:
        return Refusal("corners-on-a-line", "the corners lie on a line; take some that do not")
    return None


def _sources(data: TouchData, look: LookTaken, off: PointsOff, seen: Array) -> dict[str, Array]:
    """Covariances (3k, 3k) of what the points are off by, m^2, by their causes."""
    config, k = data.job, len(data.stood)
    camera, at_look, tool = (A.reshape(3 * k, -1) for A in (off.by_camera, off.by_look, off.by_tool))
    Q = np.array([look.q, *(at.q for at in data.stood)])
    arm = arm_errors(data.arm(), Q, data.arm_rms_m)
    by_arm = (off.by_flange @ arm.columns[1:] + off.by_look @ arm.columns[0]).reshape(3 * k, -1)
    repeat = stated_sigma(getattr(data.arm(), "model", None)) ** 2
    still = np.diag([repeat] * 3 + [0.0] * 3)
    return {
        "hand-eye": camera @ np.array(data.hand_eye_cov) @ camera.T,
        "arm model": by_arm @ arm.cov @ by_arm.T,
        "arm repeatability": at_look @ still @ at_look.T + repeat * np.eye(3 * k),
        "tool": config.tool_sigma_m**2 * tool @ tool.T,
        "look": camera @ seen @ camera.T,
        BY_HAND: config.stand_sigma_m**2 * np.eye(3 * k),
    }


def _by_board(look: LookTaken, printed: Array, standing: Standing, off: PointsOff) -> Array:
    """(3k, 5) what the points are off by for a unit of each number of ``TARGET``: it moves the board that the
    camera locates, and the points over which the tool stood."""
    view = view_of(look, printed)
    shape = target_shape([view])
    moves = image_terms([view], standing.C[None], look.lens_in_use(), shape).moves[0][:, len(LENS) :]
    by_print = off.by_camera @ moves - shape.columns(standing.places)
    return np.asarray(by_print.reshape(-1, len(TARGET)))


def _board_cov(data: TouchData, look: LookTaken) -> Array:
    """(5, 5) of the numbers of ``TARGET``: its size as the hand-eye found it, else its size and always its
    bow as the hand-eye knows them beforehand."""
    cov: Array = np.diag(target_prior(data.spec).sigma() ** 2)
    if look.printed is not None:  # errors of the arm's lengths are in both axes alike
        sigma = [look.printed.sigma_x, look.printed.sigma_y]
        cov[:2, :2] = np.outer(sigma, sigma)
    return cov


def _result(
    data: TouchData,
    off: PointsOff,
    found: CommonMotion,
    by_source: dict[str, Array],
    T_base_target: Array,
    inputs: TouchInputs,
) -> TouchResult:
    cov = np.asarray(sum(by_source.values()))
    xi = np.concatenate([found.shift, found.turn])
    chance = float(chdtrc(len(xi), xi @ np.linalg.solve(cov, xi)))
    shift, turn = (float(np.linalg.norm(v)) for v in (found.shift, found.turn))
    shift_95, turn_95 = (length95(cov[part, part]) for part in (slice(0, 3), slice(3, 6)))
    causes = [CauseOff(source=name, sigma_m=_axis(one[:3, :3])) for name, one in by_source.items()]
    free = off.off.size - len(xi)
    residuals = TouchResiduals(
        meaning="what a common shift and turn leave; an unsteady hand, or a board that is not flat",
        rms_m=float(np.sqrt(np.sum(found.left**2) / free)),
        expected_m=data.job.stand_sigma_m,
    )
    warnings = _warnings(data, residuals, free)
    result = TouchResult(
        verdict="pass",
        result=TouchAnswer(
            T_base_target=[float(v) for v in T_base_target],
            shift=found.shift.tolist(),
            shift_m=shift,
            turn=found.turn.tolist(),
            turn_rad=turn,
            chance=chance,
            corners=[
                CornerOff(corner=at.corner, off=one.tolist(), off_m=float(np.linalg.norm(one)))
                for at, one in zip(data.stood, off.off, strict=True)
            ],
        ),
        uncertainty=TouchUncertainty(
            meaning="of shift and turn by what is known of hand-eye, board, arm, tool, look and hand; the "
            "arm's errors are in the hand-eye's covariance as well, and count a second time there",
            cov=cov.tolist(),
            shift_95_m=shift_95,
            turn_95_rad=turn_95,
            by_source=sorted(causes, key=lambda cause: (-round(cause.sigma_m, _SAME_DIGITS), cause.source)),
        ),
        residuals=residuals,
        observability=TouchObservability(undetermined=list(_NOT_TOLD)),
        inputs=inputs,
    )
    reasons = []
    if chance < SURE:
        reasons.append(
            f"off: the tool's point is {mm(shift)} (uncertainty {mm(shift_95)}, 95 %) from where the camera "
            f"has the board, and turned by {deg(turn)}: tool, camera or arm has changed"
        )
    judged = result.judged(reasons, Warning_.each(warnings))
    return judged.changed(reasons=[*judged.reasons, *(text for _, text in warnings)])


def _warnings(data: TouchData, residuals: TouchResiduals, free: int) -> list[tuple[str, str]]:
    out = []
    if free * (residuals.rms_m / residuals.expected_m) ** 2 > chdtri(free, SURE):
        out.append(
            (
                "touch.spread",
                f"the corners scatter by {mm(residuals.rms_m)}, and stand_sigma_m is "
                f"{mm(residuals.expected_m)}: bring the point there with more care, or see whether the board "
                "is flat and as large as stated, and was not moved",
            )
        )
    if data.tool_reference is None:
        text = (
            "no laser reference of the tool is accepted: its point is as configured, and nothing checked it"
        )
        out.append(("touch.tool-unchecked", text))
    return out


def _axis(cov: Array) -> float:
    """Standard deviation along an axis, of a covariance (3, 3)."""
    return float(np.sqrt(np.trace(cov) / 3.0))
