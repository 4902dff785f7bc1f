"""The tool's displacement, or a reference, from passes across two beams: the path of jobs and of replay."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from calibration.refusal import Refusal
from calibration.tool_frame.beams import find_beams
from calibration.tool_frame.checks import held_out, own_residuals
from calibration.tool_frame.classic import Classic, solve_classic
from calibration.tool_frame.lateral import AVERAGING, INTERVAL
from calibration.tool_frame.places import at_current_places
from calibration.tool_frame.scene import Refused
from calibration.tool_frame.solution import solve, solve_across
from cell.errors import error
from cell.formats.laser import LaserData
from cell.formats.result import Result
from procedures.laser.result import LaserInputs, LaserResult, Passes, ReferenceResult
from procedures.laser.solve.data import load_laser, scene_of, unit_warnings
from procedures.laser.solve.result import fill_reference, fill_result
from procedures.solving import refused, within_limits
from procedures.timed import timed

CLASSIC = "classic"
METHODS = (INTERVAL, AVERAGING, CLASSIC)
LIMITS = ("max_shift_m", "max_tilt_rad")
Progress = Callable[[str, int, int], None]
_FOLD_POINTS = 128


@within_limits
def solve_laser(
    path: Path,
    method: str | None = None,
    progress: Progress | None = None,
    limits: Mapping[str, float] | None = None,
    calls: int = 1,
) -> LaserResult | Result:
    """The result of kind ``laser`` from a data set, its folder or its ``laser.json``.

    ``method`` is ``interval`` (the likelihood of the polls' intervals, the default), ``averaging`` (their
    middles, otherwise the same) or ``classic``. ``limits`` may hold ``max_shift_m`` and
    ``max_tilt_rad``: beyond them the tool is bent, the verdict is fail and the answer is given all the same.
    ``solve_seconds`` is the shortest time of ``calls`` calls (one where it takes long), for those who
    compare it.
    Bad input raises an ``InputError``; data that cannot determine the answer give ``result`` null.
    """
    chosen = method or INTERVAL
    if chosen not in METHODS:
        raise error("ARGUMENT_INVALID", f"method is {method!r}; it must be one of {', '.join(METHODS)}")
    if unknown := sorted(set(limits or {}) - set(LIMITS)):
        raise error("ARGUMENT_INVALID", f"limit {unknown[0]!r} is not known; there is {', '.join(LIMITS)}")
    file, data = load_laser(Path(path))
    scene = at_current_places(scene_of(data))
    warnings = unit_warnings(data)
    inputs = _inputs(file, data, chosen)
    how = AVERAGING if chosen == AVERAGING else INTERVAL
    _tell(progress, "solve", 0)
    try:
        # Each call with a scene that was not looked at, or the second one would find it half done.
        solution, seconds = timed(lambda: solve(replace(scene), how), calls)
        classic: Classic | None = None
        if chosen == CLASSIC:
            classic, seconds = timed(lambda: solve_classic(scene, solution.seen), calls)
    except Refused as exc:
        return _refused("laser", exc.refusal, warnings, inputs)
    inputs = inputs.changed(solve_seconds=seconds)
    _tell(progress, "held out", 0)
    checks = None
    if classic is None:
        checks = held_out(scene, solution, partial(solve_across, method=how, points=_FOLD_POINTS))
    result = fill_result(
        scene, solution, classic, own_residuals(solution), checks, [*warnings, *solution.warnings], inputs
    )
    _tell(progress, "held out", 1)
    return _limited(result, limits or {})


@within_limits
def solve_reference(path: Path, progress: Progress | None = None, calls: int = 1) -> ReferenceResult | Result:
    """The result of kind ``laser-reference`` from the reference passes of a data set.

    They cross each beam at two places 40 mm apart or more. ``current.passes`` may be empty, and is not
    looked at. ``calls`` as in :func:`solve_laser`.
    """
    file, data = load_laser(Path(path), current=False)
    scene = scene_of(data)
    warnings = unit_warnings(data)
    inputs = _inputs(file, data, INTERVAL)
    _tell(progress, "solve", 0)
    try:
        found, seconds = timed(lambda: find_beams(scene), calls)
    except Refused as exc:
        return _refused("laser-reference", exc.refusal, warnings, inputs)
    _tell(progress, "solve", 1)
    inputs = inputs.changed(solve_seconds=seconds)
    return fill_reference(data, found, [*warnings, *found.warnings], inputs)


def _inputs(file: Path, data: LaserData, method: str) -> LaserInputs:
    return LaserInputs(
        path=str(file),
        method=method,
        tool=data.tool.id,
        passes=Passes(reference=len(data.reference.passes), current=len(data.current.passes)),
    )


def _refused(kind: str, refusal: Refusal, warnings: list[tuple[str, str]], inputs: LaserInputs) -> Result:
    return refused(kind, refusal, warnings, inputs, undetermined=[refusal.words])


def _limited(result: LaserResult, limits: Mapping[str, float]) -> LaserResult:
    """Fail with the limit's name when the tool is bent beyond it; nothing is corrected then."""
    reasons = []
    shift, turn = float(np.linalg.norm(result.result.dp_flange)), result.result.drot_flange
    if (limit := limits.get("max_shift_m")) is not None and shift > limit:
        reasons.append(
            f"bent-tool: max_shift_m: the point is {1e3 * shift:.3f} mm off the reference, the limit is "
            f"{1e3 * limit:g} mm"
        )
    tilt = None if turn is None else float(np.linalg.norm(turn))
    if (limit := limits.get("max_tilt_rad")) is not None and tilt is not None and tilt > limit:
        reasons.append(
            f"bent-tool: max_tilt_rad: the axis is {np.degrees(tilt):.3f} deg off the reference, the limit "
            f"is {np.degrees(limit):.3f} deg"
        )
    return result.judged(reasons)


def _tell(progress: Progress | None, stage: str, done: int) -> None:
    if progress is not None:
        progress(stage, done, 1)
