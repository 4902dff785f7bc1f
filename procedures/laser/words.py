"""The result of a crossed-beam job in words."""

from collections.abc import Mapping, Sequence
from math import degrees, hypot, sqrt
from typing import Any

from procedures.laser.moved_words import axis_words, point_words
from procedures.words import deg, mm, ms, pose_text


def laser_lines(result: Mapping[str, Any], answer: Mapping[str, Any]) -> list[str]:
    """How far the tool's point moved and its axis turned, how sure that is, and against which limits."""
    dp, drot, cov = answer["dp_flange"], answer.get("drot_flange"), answer.get("cov")
    lines = [
        f"  the tool's point is {mm(hypot(*dp))} from where the reference has it",
        f"  in the flange x, y, z [{_mms(dp)}] mm{_pm(cov, 0)}",
    ]
    if drot is None:
        lines.append("  the tilt was not measured: that takes passes at two heights")
    else:
        lines.append(f"  the axis is tilted by {deg(hypot(*drot))}; about x, y, z [{_degs(drot)}] deg")
    if (U := uncertainty(result)) is not None:
        lines.append(f"  U = {mm(U)}: 95 % of the errors of that point are below this")
    if moved := answer.get("moved"):
        lines += _moved(moved)
    elif last := answer.get("against_last"):
        lines.append(f"  against the tool frame in effect {mm(last['shift'])}, {deg(last['tilt_rad'])}")
    if answer.get("T_flange_tool"):
        lines.append(f"  tool frame by this measurement T_flange_tool = {pose_text(answer['T_flange_tool'])}")
    return [*lines, *_delays(answer), *_update((result.get("inputs") or {}).get("update") or {})]


def _moved(test: Mapping[str, Any]) -> list[str]:
    """The test of a check, whatever came of it: the figure against the frame in effect, and its tolerance."""
    verdict = "the tool has moved" if test["moved"] else "the tool has not moved"
    lines = [f"  {verdict} against the tool frame in effect: point {point_words(test)}"]
    if test["tilt_rad"] is not None:
        lines.append(f"    axis {axis_words(test)}")
    if (size := test.get("detectable_m")) is not None:
        lines.append(f"    a shift of {mm(size)} is found in 99 of 100 checks")
    return lines


def _update(update: Mapping[str, Any]) -> list[str]:
    """What became of the new tool frame, and what the scan with it showed."""
    lines = []
    if second := update.get("second_scan"):
        apart, within = second.get("apart"), "within" if second.get("meets") else "beyond"
        if apart is not None:
            scans = "second and third scan" if second.get("scans") == 2 else "second scan"
            lines.append(
                f"  {scans}: the point is {mm(apart)} off the reference, {within} the limit of "
                f"{mm(second['U_m'])}"
            )
            if (size := second.get("detectable_m")) is not None:
                lines.append(f"    an error of the frame of {mm(size)} is found in 99 of 100")
    if update.get("committed"):
        lines.append(
            f"  the new frame is in effect from the next job on, accepted by {update.get('accepted_by')}"
        )
    elif update.get("committed") is False:
        lines.append(f"  the new frame was not put into effect: {update.get('why')}")
    if update.get("controller_tool") in ("candidate", "unknown"):
        lines.append(
            "  the controller may still hold the TCP that was tried; the next job sets the one in effect "
            "before it moves"
        )
    return lines


def reference_lines(result: Mapping[str, Any], answer: Mapping[str, Any]) -> list[str]:
    """Where the beams were found, and how well the tool's point is known in them."""
    lines = []
    for name, beam in (answer.get("beams") or {}).items():
        lines.append(f"  beam {name} through [{_mms(beam['point'])}] mm along {_unit(beam['dir'])} in base")
    plane = answer.get("plane") or {}
    for name, slope in (plane.get("slope_rad") or {}).items():
        lines.append(f"  beam {name} rises by {deg(abs(slope), 3)} against base x-y")
    if (gap := plane.get("gap_m")) is not None:
        lines.append(f"  height between the two beams where they cross {mm(abs(gap))}")
    for name, at in (answer.get("hits") or {}).items():
        if at is not None:
            lines.append(f"  the tool's point meets {name} with the flange at [{_mms(at)}] mm in base")
    if (U := uncertainty(result)) is not None:
        lines.append(f"  U = {mm(U)}: 95 % of the errors of the tool's point in the beams are below this")
    return lines + _delays(answer)


def uncertainty(result: Mapping[str, Any]) -> float | None:
    """The length (m) that 95 % of the errors of the tool's point stay below; None when it is not known."""
    stated: float | None = (result.get("uncertainty") or {}).get("U_point_m")
    cov = (result.get("result") or {}).get("cov")
    if stated is not None or cov is None:
        return stated
    import numpy as np

    from procedures.report.numbers import radius95

    return radius95(np.array(cov)[:3, :3])


def _delays(answer: Mapping[str, Any]) -> list[str]:
    """``latency_s`` is all of it, ``tau`` (in a reference ``tau_s``) what is not taken off the stamps yet."""
    lines = []
    left = answer.get("tau", answer.get("tau_s"))
    if answer.get("latency_s") is not None:
        lines.append(f"  the inputs are late by {ms(answer['latency_s'])}")
    elif left is not None:
        lines.append(f"  the inputs are later by {ms(left)} than their stamps say")
    return lines + hysteresis_lines(answer)


def _pm(cov: Sequence[Sequence[float]] | None, first: int) -> str:
    if cov is None:
        return ", without uncertainty"
    sigma = [sqrt(max(cov[i][i], 0.0)) for i in range(first, first + 3)]
    return f", standard uncertainty {', '.join(f'{1e3 * s:.4f}' for s in sigma)} mm"


def _mms(values: Sequence[float]) -> str:
    return ", ".join(f"{1e3 * v:.4f}" for v in values)


def _degs(values: Sequence[float]) -> str:
    return ", ".join(f"{degrees(v):.4f}" for v in values)


def _unit(values: Sequence[float]) -> str:
    return "[" + ", ".join(f"{v:.5f}" for v in values) + "]"


def hysteresis_lines(answer: Mapping[str, Any]) -> list[str]:
    """One line when the hysteresis of the beams was measured."""
    found = answer.get("hysteresis_m")
    return [] if found is None else [f"  hysteresis {mm(found, 4)}"]
