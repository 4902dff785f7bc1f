"""``cellward solve axbc``: the standard hand-eye from a target at a known place, and what it is good for."""

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.adjustment.bare_poses import adjust_poses
from calibration.adjustment.hand_eye import adjust, as_found
from calibration.adjustment.lens_terms import LensPrior
from calibration.adjustment.mount import (
    PLACE_DOUBTED,
    Mounted,
    for_controller,
    mounted,
    suspicion,
    with_place,
)
from calibration.adjustment.shared_errors import SharedErrors, shared_errors
from calibration.adjustment.target_correction import (
    CameraAndTarget,
    ChosenWay,
    Corrected,
    choose,
)
from calibration.adjustment.unknowns import ArmKnown
from calibration.hand_eye.solution import Measurements, solve
from calibration.refusal import Refusal
from cell.errors import error
from cell.formats.result import Result, Warning_
from cell.poses import Array
from procedures.eye_to_hand.judging import blame_warning, doubts_about, reasons_against
from procedures.eye_to_hand.result import AxbcHeldOut, AxbcInputs, AxbcResult, AxbcUncertainty
from procedures.eye_to_hand.solve.answer import (
    ARM_WORSE,
    Found,
    answer_of,
    arm_text,
    constant_of,
    residuals_of,
)
from procedures.eye_to_hand.solve.commands import TargetCorrections, answer_targets
from procedures.eye_to_hand.solve.data import AxbcData, load_axbc
from procedures.eye_to_hand.solve.driven import driven_targets, driven_warnings, require_one_kind
from procedures.hand_eye.known_parts import KnownParts, known_parts, shared_source, without_joints
from procedures.hand_eye.solve.adjustment import NOT_SETTLED
from procedures.hand_eye.solve.arm import JOINTS, GivenArm, given_arm
from procedures.hand_eye.solve.camera import CameraChoice, check_views, choose_camera
from procedures.hand_eye.solve.solver import given_noise, measurements, one_thread
from procedures.solving import Progress, refused, within_limits
from procedures.timed import timed

LENS_AS_GIVEN = LensPrior(focal=1e-6, aspect=1e-6, centre_px=1e-3, radial=1e-6, tangential=1e-6)
_ARM_REJECTED = "arm.beyond-prior"


@within_limits
def solve_axbc(
    path: Path,
    *,
    method: str | None = None,
    targets: Path | None = None,
    progress: Progress | None = None,
    calls: int = 1,
) -> AxbcResult | Result:
    """The result of a ``cellward.axbc/1``: its folder or its file.

    ``targets`` is a ``cellward.axbc-targets/1``: poses of the flange in the camera whose commands are wanted.
    ``calls``: how often it is solved, for those who compare its time. Bad input raises an ``InputError``.
    """
    if method is not None:
        raise error("ARGUMENT_INVALID", f"method is {method!r}; axbc has one method only, leave it out")
    with one_thread():
        data = load_axbc(Path(path), progress)
        camera = choose_camera(data.seen, adjusts=True)
        check_views(data.seen, camera.camera)
        return _solve(data, camera, targets, calls)


def _solve(data: AxbcData, camera: CameraChoice, targets: Path | None, calls: int) -> AxbcResult | Result:
    loaded = data.seen
    rows = loaded.usable()
    warnings = [*loaded.warnings, *camera.warnings]
    inputs: dict[str, Any] = {"observations": len(loaded.F), "usable": len(rows)}
    arm_of = given_arm(loaded, rows)
    measured = measurements(loaded, rows)
    _one_kind(loaded.path, measured)
    if data.arrived is not None:
        require_one_kind(loaded.path, data.arrived, measured.views[0] is not None)
    known = _known(data, camera, arm_of[0])
    find = partial(_find, data, measured, camera, arm_of[0], known)
    found, inputs["solve_seconds"] = timed(find, calls)
    if isinstance(found, Refusal):
        return refused("axbc", found, warnings, inputs, unobservable=[found.words])
    sources = dict(known.sources) | data.known
    if isinstance(found.arm, SharedErrors):
        warnings.append(without_joints(arm_of[1], *found.arm.sizes(found.alone.scale)))
        sources["arm"] = shared_source(*found.arm.sizes({}))
    choice = _choice(data, found)
    answer = answer_of(data, found, choice, arm_of[0])
    if max(found.alone.scale.values(), default=0.0) > ARM_WORSE:
        warnings.append((_ARM_REJECTED, arm_text(found.alone)))
    if found.images is not None and not found.images.settled:
        warnings.append(NOT_SETTLED)
    if targets is not None:
        model = (found.standard, found.arm) if isinstance(found.arm, ArmKnown) else None
        ways = TargetCorrections(data.camera.T, constant_of(data, found), model)
        commands, more = answer_targets(targets, ways, choice.chosen)
        answer = answer.changed(commands=commands)
        warnings += more
    if (driven := driven_targets(data, found)) is not None:
        answer = answer.changed(driven=driven)
        warnings += driven_warnings(driven)
    reasons: list[str] = []
    warnings += blame_warning(answer)
    if (limits := data.document.limits) is not None:
        reasons = reasons_against(answer, limits)
        warnings += doubts_about(answer, limits)
    return AxbcResult(
        kind="axbc",
        verdict="fail" if reasons else "warn" if warnings else "pass",
        reasons=[*reasons, *(text for _, text in warnings)],
        warnings=Warning_.each(warnings),
        result=answer,
        uncertainty=AxbcUncertainty(
            meaning="of T_camera_base, perturbation on the right: noise, arm, gears, sag, lens and target",
            cov=answer.cov,
            priors=sources,
        ),
        residuals=residuals_of(found),
        heldout=AxbcHeldOut(
            meaning="RMS distance of the target from where each way predicts it, from the other folds",
            folds=5,
            observations=len(found.rows),
            **{f"rms_{way}": rms for way, rms in choice.cv.items()},
        ),
        inputs=AxbcInputs(**inputs, used=len(found.rows)),
    )


def _known(data: AxbcData, camera: CameraChoice, arm: GivenArm | None) -> KnownParts:
    """Wanted poses are measured with the camera as it is given, so its lens is no unknown, unless the data
    state how well it is known."""
    capture = data.seen.capture
    sigma = None if capture.camera is None else capture.camera.sigma
    known = known_parts(
        capture.target.model_dump(),
        None if sigma is None else sigma.model_dump(),
        None if arm is None else arm.spec.robot,
        from_images=camera.estimated is not None,
    )
    if sigma is not None or camera.estimated is not None:
        return known
    return replace(known, lens=LENS_AS_GIVEN, sources={**known.sources, "lens": "taken as it is given"})


def _one_kind(path: Path, measured: Measurements) -> None:
    with_views = sum(view is not None for view in measured.views)
    if 0 < with_views < len(measured.views):
        raise error(
            "DATA_INVALID",
            f"{path}: {with_views} of {len(measured.views)} observations have corners or images and the "
            "others a bare T_camera_marker; give the same for all of them",
        )


def _find(
    data: AxbcData, measured: Measurements, camera: CameraChoice, arm: GivenArm | None, known: KnownParts
) -> Found | Refusal:
    solution = solve(measured, camera.camera, given_noise(data.seen))
    if isinstance(solution, Refusal):
        return solution
    rows = np.flatnonzero(solution.used)
    own: ArmKnown | SharedErrors
    if arm is None:
        own = shared_errors(measured.F[rows], known.arm)
    else:
        limits = np.tile([-np.pi, np.pi], (JOINTS, 1))
        own = ArmKnown(arm.spec.arm, arm.Q, limits, known.arm)
    if measured.views[0] is None or camera.camera is None:
        alone, adjusted = adjust_poses(solution, own), None
    else:
        adjusted = adjust(measured, solution, camera.camera, own, known.lens, known.target)
        _, problem = as_found(adjusted, measured, solution)
        solution = replace(solution, problem=replace(problem, G=measured.F))
        alone = mounted(adjusted, own)
    judged = suspicion(for_controller(alone), data.camera, data.place)
    # A wrong place would move the camera.
    standard = alone if judged.blamed in PLACE_DOUBTED else with_place(alone, data.place)
    return Found(solution, rows, measured.F[rows], own, alone, judged, standard, adjusted)


def _choice(data: AxbcData, found: Found) -> ChosenWay:
    """Which way to correct targets, by observations that were not looked at; lens and print are of all."""
    given = CameraAndTarget(data.camera.T, data.place.T)
    arm = found.arm
    folds: dict[bytes, Mounted] = {}

    def alone(rest: NDArray[np.int64]) -> Mounted:
        if (key := rest.tobytes()) not in folds:
            used = np.zeros(len(found.solution.used), dtype=bool)
            used[found.rows[rest]] = True
            folds[key] = adjust_poses(replace(found.solution, used=used), arm)
        return folds[key]

    def model(rest: NDArray[np.int64]) -> Mounted:
        return alone(rest) if found.place_doubted else with_place(alone(rest), data.place)

    def place(rest: NDArray[np.int64]) -> Array:
        return alone(rest).W

    corrected = Corrected(arm, arm.Q[found.rows], model) if isinstance(arm, ArmKnown) else None
    return choose(given, found.F, found.C, corrected, place if found.place_doubted else None)
