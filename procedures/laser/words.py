"""The result of a crossed-beam job in words."""

from collections.abc import Mapping, Sequence
from math import degrees, hypot, sqrt
from typing import Any

from cell.formats.result import Covariance
from procedures.laser.moved_words import axis_words, point_words
from procedures.laser.odds_words import odds_of
from procedures.laser.result import LaserResult, MovedTest, ReferenceResult, SecondScan, Update
from procedures.words import deg, mm, ms, pose_text


def laser_lines(found: LaserResult) -> list[str]:
    """How far the tool's point moved and its axis turned, how sure that is, and against which limits."""
    answer = found.result
    dp, drot, cov = answer.dp_flange, answer.drot_flange, answer.cov
    lines = [
        f"  the tool's point is {mm(hypot(*dp))} from where the reference has it",
        f"  in the flange x, y, z [{_mms(dp)}] mm{_pm(cov, 0)}",
    ]
    if drot is None:
        lines.append("  the tilt was not measured: that takes passes at two heights")
    else:
        lines.append(f"  the axis is tilted by {deg(hypot(*drot))}; about x, y, z [{_degs(drot)}] deg")
    if (U := uncertainty(found.uncertainty.U_point_m, cov)) is not None:
        lines.append(f"  U = {mm(U)}: 95 % of the errors of that point are below this")
    if answer.moved:
        lines += _moved(answer.moved)
    elif last := answer.against_last:
        lines.append(f"  against the tool frame in effect {mm(last.shift)}, {deg(last.tilt_rad)}")
    if answer.T_flange_tool:
        lines.append(f"  tool frame by this measurement T_flange_tool = {pose_text(answer.T_flange_tool)}")
    lines += _delays(answer.latency_s, answer.tau, answer.hysteresis_m)
    return lines + (_update(found.inputs.update) if found.inputs.update else [])


def _moved(test: MovedTest) -> list[str]:
    """The test of a check, whatever came of it: the figure against the frame in effect, and its tolerance."""
    verdict = "the tool has moved" if test.moved else "the tool has not moved"
    lines = [f"  {verdict} against the tool frame in effect: point {point_words(test)}"]
    if axis := axis_words(test):
        lines.append(f"    axis {axis}")
    return [*lines, *_odds(test)]


def _odds(test: MovedTest | SecondScan) -> list[str]:
    return [f"    {told}"] if (told := odds_of(test)) else []


def _update(update: Update) -> list[str]:
    """What became of the new tool frame, and what the scan with it showed."""
    lines = []
    if (second := update.second_scan) and second.apart is not None:
        within = "within" if second.meets else "beyond"
        scans = "second and third scan" if second.scans == 2 else "second scan"
        lines.append(
            f"  {scans}: the point is {mm(second.apart)} off the reference, {within} the limit of "
            f"{mm(second.U_m)}"
        )
        lines += _odds(second)
    if update.committed:
        lines.append(f"  the new frame is in effect from the next job on, accepted by {update.accepted_by}")
    elif update.committed is False:
        lines.append(f"  the new frame was not put into effect: {update.why}")
    if update.controller_tool in ("candidate", "unknown"):
        lines.append(
            "  the controller may still hold the TCP that was tried; the next job sets the one in effect "
            "before it moves"
        )
    return lines


def reference_lines(found: ReferenceResult) -> list[str]:
    """Where the beams were found, and how well the tool's point is known in them."""
    answer, lines = found.result, []
    for name, beam in answer.beams.items():
        lines.append(f"  beam {name} through [{_mms(beam.point)}] mm along {_unit(beam.dir)} in base")
    for name, slope in answer.plane.slope_rad.items():
        lines.append(f"  beam {name} rises by {deg(abs(slope), 3)} against base x-y")
    lines.append(f"  height between the two beams where they cross {mm(abs(answer.plane.gap_m))}")
    for name, at in answer.hits.items():
        if at is not None:
            lines.append(f"  the tool's point meets {name} with the flange at [{_mms(at)}] mm in base")
    U = found.uncertainty.U_point_m
    lines.append(
        f"  U = {mm(U)}: 95 % of the errors of the tool's point in the beams are below this; how accurately "
        "the arm itself knows that place is not in it, and cancels in a check"
    )
    return lines + _delays(None, answer.tau, answer.hysteresis_m)


def uncertainty(stated: float | None, cov: Covariance | None) -> float | None:
    """The length (m) that 95 % of the errors of the tool's point stay below; None when it is not known."""
    if stated is not None or cov is None:
        return stated
    import numpy as np

    from calibration.lengths import length95

    return length95(np.array(cov)[:3, :3])


def _delays(latency_s: float | None, tau: float | None, hysteresis_m: float | None) -> list[str]:
    """``latency_s`` is all of the delay, ``tau`` what is not taken off the stamps yet."""
    lines = []
    if latency_s is not None:
        lines.append(f"  the inputs are late by {ms(latency_s)}")
    elif tau is not None:
        lines.append(f"  the inputs are later by {ms(tau)} than their stamps say")
    return lines + hysteresis_lines(hysteresis_m)


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


def hysteresis_lines(found: float | None) -> list[str]:
    """One line when the hysteresis of the beams was measured (m)."""
    return [] if found is None else [f"  hysteresis {mm(found, 4)}"]


def reference_value(value: Mapping[str, Any]) -> str:
    """A reference in the ledger, in a line."""
    tool, hits = value.get("tool") or {}, value.get("hits") or {}
    at = ", ".join(f"{beam} [{', '.join(f'{1e3 * v:.3f}' for v in p)}] mm" for beam, p in hits.items() if p)
    passes = len(value.get("passes") or [])
    text = f"tool {tool.get('id')}, flange at the beams {at or 'unknown'}, {passes} passes"
    return f"{text}, delay {ms(value['tau_s'])}" if value.get("tau_s") is not None else text
