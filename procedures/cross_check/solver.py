"""``cellward cross-check``: two captures, a tool measured or driven over a board, and what has changed."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field

from calibration.adjustment.arm_by_tracker import FEWEST_PLACES, SeenArm, seen_arm
from calibration.adjustment.cross_check import (
    CrossChecked,
    SeenCamera,
    SeenTool,
    cross_check,
    seen_camera,
)
from calibration.adjustment.hand_eye import Adjusted, adjust
from calibration.adjustment.lens_terms import LensPrior
from calibration.adjustment.touch import SeenTouch, Touches, seen_touch
from calibration.adjustment.unknowns import ArmKnown
from calibration.hand_eye.problem import Setup
from calibration.hand_eye.solution import solve
from calibration.refusal import Refusal
from calibration.targets import make_target
from calibration.tool_frame.repeatability import stated_sigma
from cell.devices import Intrinsics
from cell.errors import error
from cell.formats.reading import Strict, parse, read_json
from cell.formats.result import Inputs, Result, Warning_
from cell.poses import Array
from cell.run_values import RunValues
from procedures.arm_setup import arm_model
from procedures.cross_check.result import (
    CrossCheckAnswer,
    CrossCheckHeldOut,
    CrossCheckInputs,
    CrossCheckObservability,
    CrossCheckResiduals,
    CrossCheckResult,
    CrossCheckUncertainty,
)
from procedures.cross_check.words import JOINTS, said
from procedures.documents import read_result
from procedures.hand_eye.known_parts import known_parts
from procedures.hand_eye.solve.adjustment import NOT_SETTLED
from procedures.hand_eye.solve.arm import given_arm
from procedures.hand_eye.solve.camera import check_views, choose_camera
from procedures.hand_eye.solve.capture import CaptureSet, load_capture
from procedures.hand_eye.solve.solver import given_noise, measurements, one_thread
from procedures.laser.config import Search
from procedures.laser.measurement import reference_of
from procedures.laser.result import LaserResult
from procedures.solving import Progress, require_no_method, within_limits
from procedures.touch_test.data import read_data_set, view_of
from procedures.touch_test.judging import CORNER_PX, FEWEST
from procedures.tracker.solve.data import load_kincal

FILE_NAME = "cross-check.json"
SCHEMA = "cellward.cross-check/1"
TRACKER_M = 2e-5  # standard deviation of a place along an axis, where the data do not state it
BEAM = "xs"  # at which the arm's joints are taken; the other one is near by


class CrossCheckSet(Strict):
    """``cross-check.json``: folders, absolute or from the file's own."""

    schema_: Literal["cellward.cross-check/1"] = Field(alias="schema")
    then: str = Field(description="capture of when all was well: the run of the camera's calibration")
    now: str = Field(description="capture of now")
    beams: str | None = Field(default=None, description="laser-check or laser-update of now")
    tracker: str | None = Field(default=None, description="tracker-sampling of the arm of now")
    touch: str | None = Field(default=None, description="touch-test of now")


@within_limits
def solve_cross_check(
    path: Path, *, method: str | None = None, progress: Progress | None = None
) -> CrossCheckResult | Result:
    """The result of a ``cellward.cross-check/1``: its folder, or the file. Bad input: an ``InputError``."""
    require_no_method("cross-check", method)
    file = path / FILE_NAME if path.is_dir() else path
    asked = parse(CrossCheckSet, read_json(file), SCHEMA, str(file))
    given = (asked.beams, asked.tracker, asked.touch)
    beams, tracker, touch = (None if f is None else file.parent / f for f in given)
    return check_cell(file.parent / asked.then, file.parent / asked.now, beams, tracker, touch, progress)


def check_cell(
    then: Path,
    now: Path,
    beams: Path | None = None,
    tracker: Path | None = None,
    touch: Path | None = None,
    progress: Progress | None = None,
) -> CrossCheckResult | Result:
    """From the folders of two captures, of a run that measured the tool, of one that sampled the arm, and of
    a touch test."""
    began = time.perf_counter()
    show: Callable[[str, int, int], None] = progress or (lambda *_: None)
    cameras: list[_Capture] = []
    with one_thread():
        both = [load_capture(folder) for folder in (then, now)]
        if _same(*both):
            text = f"{then} and {now} hold one and the same capture; give that of then and another one of now"
            raise error("ARGUMENT_INVALID", text)
        for k, (folder, loaded) in enumerate(zip((then, now), both, strict=True)):
            show("solve", k, 2)
            one = _camera_of(loaded)
            if isinstance(one, Refusal):
                return Result(
                    kind="cross-check",
                    verdict="fail",
                    reasons=[f"{one.name}: {folder}: {one.words}"],
                    result=None,
                    inputs=Inputs(solve_seconds=time.perf_counter() - began),
                )
            cameras.append(one)
    first, last = cameras
    if first.setup != last.setup:
        text = f"{then} is {first.setup}, {now} is {last.setup}; give two captures of one camera"
        raise error("ARGUMENT_INVALID", text)
    if (first.given, first.lens) == (last.given, last.lens):
        first, last = first.with_lens(), last.with_lens()
    tool = None if beams is None else tool_of(beams)
    by_tracker = None if tracker is None else _arm_by(tracker, last.arm)
    by_touch = None if touch is None else touch_of(touch, last)
    found = cross_check(first.seen, last.seen, tool, last.adjusted.names, by_tracker, by_touch)
    show("solve", 2, 2)
    inputs = CrossCheckInputs(
        then=str(then),
        now=str(now),
        beams=None if beams is None else str(beams),
        tracker=None if tracker is None else str(tracker),
        touch=None if touch is None else str(touch),
        setup=first.setup,
        solve_seconds=time.perf_counter() - began,
    )
    residuals = CrossCheckResiduals(then_px=first.px, now_px=last.px)
    given = {"the beams": tool, "the touch test": by_touch}
    tool_by = " and ".join(by for by, one in given.items() if one is not None)
    settled = first.adjusted.settled and last.adjusted.settled
    return _result(found, inputs, residuals, tool_by, [] if settled else [NOT_SETTLED])


@dataclass(frozen=True)
class _Capture:
    """Where the camera of a capture is, its ``target``, the ``arm``, the adjustment, and what that says of
    the camera; ``px`` is the noise of a corner. ``given`` is the lens as it was given, ``lens`` how well."""

    setup: Setup
    target: Mapping[str, Any]
    arm: ArmKnown
    given: Intrinsics
    lens: LensPrior
    adjusted: Adjusted
    seen: SeenCamera

    def with_lens(self) -> "_Capture":
        """For another capture of the same lens."""
        return replace(self, seen=seen_camera(self.adjusted, self.arm, self.lens))

    @property
    def px(self) -> float | None:
        return self.adjusted.components.sigma.get("sigma_px")


def _same(one: CaptureSet, other: CaptureSet) -> bool:
    """Whether these are the same pictures: of no two are all corners the same to the last digit."""
    seen, again = ([None if v is None else v.corners.tolist() for v in of.views] for of in (one, other))
    return seen == again and np.array_equal(one.F, other.F)


def _camera_of(loaded: CaptureSet) -> _Capture | Refusal:
    """What that capture says."""
    camera = choose_camera(loaded, adjusts=True)
    check_views(loaded, camera.camera)
    rows = loaded.usable()
    if not len(rows) or camera.camera is None:
        return Refusal("too-few-poses", "no observation shows the target")
    given, why = given_arm(loaded, rows)
    if given is None:
        raise error("DATA_INVALID", f"{loaded.path}: {why}; a cross check needs the arm's joints")
    measured = measurements(loaded, rows)
    if any(view is None for view in measured.views):
        raise error("DATA_INVALID", f"{loaded.path}: a cross check needs the corners of every observation")
    solution = solve(measured, camera.camera, given_noise(loaded))
    if isinstance(solution, Refusal):
        return solution
    sigma = None if loaded.capture.camera is None else loaded.capture.camera.sigma
    known = known_parts(
        loaded.capture.target.model_dump(),
        None if sigma is None else sigma.model_dump(),
        given.spec.robot,
        from_images=camera.estimated is not None,
    )
    limits = np.tile([-np.pi, np.pi], (len(JOINTS), 1))
    arm = ArmKnown(given.spec.arm, given.Q, limits, known.arm)
    found = adjust(measured, solution, camera.camera, arm, known.lens, known.target)
    setup, target = loaded.capture.setup, loaded.capture.target.model_dump()
    lens, seen = known.lens, seen_camera(found, arm)
    return _Capture(setup, target, arm, camera.camera, lens, found, seen)


def _arm_by(folder: Path, arm: ArmKnown) -> SeenArm:
    """What the run in ``folder`` tells of the numbers of ``arm``."""
    loaded = load_kincal(folder)
    Q, places = loaded.problem.Q, loaded.problem.p.T
    if Q.shape[1] != len(JOINTS):
        raise error("ARGUMENT_INVALID", f"{folder}: its arm has {Q.shape[1]} joints, that of the captures 6")
    if len(Q) < FEWEST_PLACES:
        raise error("ARGUMENT_INVALID", f"{folder} has {len(Q)} places, {FEWEST_PLACES} are needed")
    noise = loaded.noise
    stated = noise.get("sigma0", TRACKER_M) + noise.get("sigma_per_m", 0.0) * np.linalg.norm(places, axis=1)
    # The arm comes to rest elsewhere each time.
    sigma = np.hypot(stated, stated_sigma(getattr(loaded.spec.robot, "model", None)))
    return seen_arm(replace(arm, Q=Q), places, loaded.problem.target, sigma)


def tool_of(folder: Path) -> SeenTool:
    """What the run in ``folder`` measured of the tool against its reference."""
    found = read_result(read_json(folder / "result.json"), str(folder))
    if not isinstance(found, LaserResult):
        raise error("ARGUMENT_INVALID", f"{folder} holds no measurement of a tool in the beams")
    if found.result.cov is None:
        raise error("ARGUMENT_INVALID", f"{folder}: the tool's point has no stated uncertainty")
    values = RunValues.of(read_json(folder / "run.json")["values"])
    cov = np.array(found.result.cov)[:3, :3]
    return SeenTool(np.array(found.result.dp_flange), cov, _by_joints(values))


def touch_of(folder: Path, now: _Capture) -> SeenTouch:
    """What the touch test in ``folder`` tells, by the capture ``now`` of the same camera and target."""
    data, file = read_data_set(folder)
    if now.setup != "eye-in-hand":
        text = "a touch test is one of a camera on the flange, and the captures are of a fixed one"
        raise error("ARGUMENT_INVALID", f"{file}: {text}; leave it out")
    designed, of_capture = (make_target(dict(target)).points for target in (data.spec, now.target))
    if designed.shape != of_capture.shape or not np.allclose(designed, of_capture, rtol=0.0, atol=1e-9):
        raise error("ARGUMENT_INVALID", f"{file} was taken with another target than the capture of now")
    if data.look is None or len(data.stood) < FEWEST:
        text = f"the tool's point stood over {len(data.stood)} corners, {FEWEST} are needed"
        raise error("ARGUMENT_INVALID", f"{file}: {text}")
    config = data.job
    touches = Touches(
        q_look=np.array(data.look.q),
        Q=np.array([at.q for at in data.stood]),
        view=view_of(data.look, designed),  # the captures have the print as unknowns
        points=designed[[at.corner for at in data.stood]],
        stand_off_m=config.stand_off_m,
        # As it was when all was well: a frame that was corrected since has the change in it.
        tool=np.array(data.tool if data.tool_reference is None else data.tool_reference),
        tool_m=config.tool_sigma_m,
        stand_m=config.stand_sigma_m,
        arm_m=stated_sigma(getattr(data.arm(), "model", None)),
    )
    px = now.px or CORNER_PX
    return seen_touch(touches, now.adjusted, now.arm, px)


def _by_joints(values: RunValues) -> Array:
    """(3, 6) how far the tool's point seems to move on the flange for a unit of each joint's zero."""
    reference, model = reference_of(values), arm_model(values)
    q = np.array(Search.from_reference(reference, None).beam(BEAM).q)
    R = model.forward(q).rotation.as_matrix()
    J = model.jacobian_many(q[None])[0]
    lever = R @ np.array(reference["tool"]["p_ref"], dtype=float)
    return np.asarray(R.T @ (J[:3] + np.cross(J[3:].T, lever).T))


def _result(
    found: CrossChecked,
    inputs: CrossCheckInputs,
    residuals: CrossCheckResiduals,
    tool_by: str,
    warnings: Sequence[tuple[str, str]],
) -> CrossCheckResult:
    """``tool_by``: what the tool was measured by, in words; empty where it was not."""
    change, sigma = found.change, found.sigma
    figures: dict[str, float] = {}
    if found.part in ("tool", "camera"):
        figures = {"t": _length(change[:3]), "t_sigma": _rms(sigma[:3])}
    if found.part in ("camera", "joint zero"):
        figures |= {"r": _length(change[-3:]), "r_sigma": _rms(sigma[-3:])}
    answer = CrossCheckAnswer(
        part=found.part,
        joint=None if found.joint is None else JOINTS[found.joint],
        probable={name: float(value) for name, value in found.probable.items()},
        **figures,
    )
    undetermined = [
        f"the zero of joint '{JOINTS[k]}': it shows in nothing that was measured" for k in found.unseen
    ]
    undetermined += [
        f"the zero of joint '{JOINTS[k]}' from a bent tool: it shows in {tool_by} alone"
        for k in found.by_beams_alone
    ]
    if not tool_by:
        undetermined.append("the tool: neither a measurement of it in the beams nor a touch test was given")
    good, open_ = answer.part == "none", answer.part == "cannot-tell"
    return CrossCheckResult(
        verdict="pass" if good else "warn" if open_ else "fail",
        reasons=[] if good else [said(answer)],
        warnings=Warning_.each([*warnings, *([("cross-check.cannot-tell", said(answer))] if open_ else [])]),
        result=answer,
        uncertainty=CrossCheckUncertainty(
            meaning="each explanation by its marginal likelihood, beforehand: "
            "nothing 0.40, one part 0.19 each, two at once 0.03"
        ),
        residuals=residuals,
        heldout=CrossCheckHeldOut(meaning="nothing: every observation is in the probabilities"),
        observability=CrossCheckObservability(undetermined=undetermined),
        inputs=inputs,
    )


def _length(v: Array) -> float:
    return float(np.linalg.norm(v))


def _rms(v: Array) -> float:
    return float(np.sqrt(np.mean(v**2)))
