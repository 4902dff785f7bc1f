"""The verdict of a crossed-beam measurement: the solver's answer held against the limits of the job.

Pure: the job and ``cellward replay`` come to the same document from the same data.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from cell.errors import present
from cell.formats.result import Result, Warning_
from cell.poses import from_pose6, to_pose6
from procedures.laser.moved import whether_moved
from procedures.laser.moved_words import moved_reasons
from procedures.laser.odds_words import odds
from procedures.laser.record import FINISHED_EARLY
from procedures.laser.result import Apart, LaserAnswer, LaserResult, ReferenceResult, SecondScan

DEG = float(np.degrees(1.0))
BENT = "bent tool"
NOT_CONFIRMED = "not confirmed"
AGAIN = 2.0  # times the limit: up to there a second scan that missed is taken once more


def corrected_tool(T_ref: Sequence[float], T_last: Sequence[float], answer: LaserAnswer) -> list[float]:
    """``T_flange_tool`` (a pose6) whose point is moved and whose axis is turned as measured.

    ``T_ref`` is the tool of the reference, ``T_last`` the one in effect, which keeps its attitude when no
    tilt was measured. The beam is hit at the same point of the base, so
    ``p + R t = const`` and ``t_new = t_ref - R^T (p_new - p_ref)``, which is ``t_ref + dp_flange``.
    """
    ref = from_pose6(T_ref)
    t = ref.translation + np.array(answer.dp_flange)
    if answer.drot_flange is None:
        rotation = from_pose6(T_last).rotation
    else:
        rotation = Rotation.from_rotvec(answer.drot_flange) * ref.rotation
    return [float(v) for v in to_pose6(RigidTransform.from_components(t, rotation))]


def finished_early(kind: str, data: Mapping[str, Any]) -> Result | None:
    """What a run comes to that was finished before both beams were measured, whose passes are ``data``.

    None for the data of a run that was not.
    """
    ways = (data.get("notes") or {}).get(FINISHED_EARLY)
    if ways is None:
        return None
    why = f"finished-early: {ways} ways were taken, and both beams must be measured to the end"
    return Result(kind=kind, verdict="fail", reasons=[why], result=None)


def judge_reference(found: ReferenceResult | Result, config: Mapping[str, Any]) -> ReferenceResult | Result:
    """A reference: beams level and in one plane, and the point known well enough."""
    if not isinstance(found, ReferenceResult):
        return found
    plane = found.result.plane
    reasons = [
        f"max_slope_rad: beam {beam} rises by {DEG * abs(slope):.2f} deg against base x-y, the limit is "
        f"{DEG * config['max_slope_rad']:.2f} deg"
        for beam, slope in plane.slope_rad.items()
        if abs(slope) > config["max_slope_rad"]
    ]
    if abs(plane.gap_m) > config["max_plane_gap_m"]:
        reasons.append(
            f"max_plane_gap_m: the beams pass each other at {1e3 * abs(plane.gap_m):.2f} mm, the limit is "
            f"{1e3 * config['max_plane_gap_m']:g} mm"
        )
    return found.judged([*reasons, *_uncertainty_reasons(found.uncertainty.U_point_m, config["max_U_m"])])


def judge_check(
    found: LaserResult | Result, known: Mapping[str, Any], config: Mapping[str, Any]
) -> LaserResult | Result:
    """A measurement against the reference and against the tool in effect.

    ``known`` has ``T_flange_tool_ref`` and ``T_flange_tool_last`` (pose6 each) and ``offset_s``, the delay of
    the inputs that the stamps were corrected by, in all.
    """
    if not isinstance(found, LaserResult):
        return found
    answer = found.result
    T_ref, offset_s = known["T_flange_tool_ref"], known["offset_s"]
    T_new = corrected_tool(T_ref, known["T_flange_tool_last"], answer)
    against_reference = moved_between(T_ref, T_new)
    against_last = moved_between(known["T_flange_tool_last"], T_new)
    reasons = [
        *_bent("against_reference", "the reference", against_reference, config["against_reference"]),
        *_bent("against_last", "the last result", against_last, config["against_last"]),
        *_uncertainty_reasons(found.uncertainty.U_point_m, config["max_U_m"]),
    ]
    warnings = []
    if (tau := answer.tau) is not None and abs(tau) > config["max_latency_s"]:
        text = (
            f"the inputs are late by {1e3 * (offset_s + tau):.1f} ms, configured are "
            f"{1e3 * offset_s:.1f} ms; run latency-calibration"
        )
        warnings.append(Warning_(code="laser.latency", text=text))
    answer = answer.changed(
        T_flange_tool=T_new,
        against_reference=against_reference,
        against_last=against_last,
        latency_s=None if tau is None else offset_s + tau,
    )
    return found.changed(result=answer).judged(reasons, warnings)


def judge_moved(
    judged: LaserResult | Result, known: Mapping[str, Any], config: Mapping[str, Any]
) -> LaserResult | Result:
    """The verdict of a check: ``judged`` by :func:`judge_check`, and whether the tool has moved.

    A bent tool keeps its own words. A ``config`` that has no tolerances asks for no test: so replay the runs
    that were made without one.
    """
    if not isinstance(judged, LaserResult) or "tolerance_m" not in config:
        return judged
    answer = judged.result
    tilted = answer.drot_flange is not None
    against_last = present(answer.against_last, "measurement that was judged")
    same = bool(np.allclose(known["T_flange_tool_ref"], known["T_flange_tool_last"], rtol=0.0, atol=1e-9))
    test = whether_moved(against_last, np.array(answer.cov), config, same, tilted)
    bent = any(reason.startswith(BENT) for reason in judged.reasons)
    return judged.changed(result=answer.changed(moved=test)).judged([] if bent else moved_reasons(test))


def why_not(second: SecondScan, max_U_m: float) -> str:
    """Why the candidate cannot be committed, empty when it can. A scan that says little confirms nothing."""
    if second.apart is None or second.U_point_m is None:
        return "; ".join(["the second scan cannot be solved", *(second.reasons or [])])
    if second.U_point_m > max_U_m:
        return (
            f"second scan: 95 % of the errors stay below {1e3 * second.U_point_m:.3f} mm, the limit "
            f"max_U_m is {1e3 * max_U_m:g} mm"
        )
    if second.meets:
        return ""
    scans = "second scan" if second.scans == 1 else "second and third scan"
    return (
        f"{scans}: the tool's point is {1e3 * second.apart:.3f} mm off the reference, more than the "
        f"{1e3 * present(second.U_m, 'limit of a scan'):.3f} mm that a right frame exceeds in "
        f"{odds(present(second.false_alarm, 'chance of a scan'))}"
    )


def worth_another(second: SecondScan, max_U_m: float) -> bool:
    """Whether a second scan missed by so little that one more scan may tell better."""
    if second.apart is None or second.U_m is None or second.U_point_m is None:
        return False
    if second.meets or second.U_point_m > max_U_m:
        return False
    return second.scans == 1 and second.apart <= AGAIN * second.U_m


def not_confirmed(measured: LaserResult, why: str) -> LaserResult:
    """An update whose candidate was not put into effect."""
    return measured.judged([f"{NOT_CONFIRMED}: {why}"])


def moved_between(before: Sequence[float], now: Sequence[float]) -> Apart:
    """How far the tool's point moved (m, in the flange) and by how much its axis turned (rad)."""
    a, b = from_pose6(before), from_pose6(now)
    z = np.array([0.0, 0.0, 1.0])
    turn = float(np.arccos(np.clip(a.rotation.apply(z) @ b.rotation.apply(z), -1.0, 1.0)))
    shift = b.translation - a.translation
    return Apart(shift_m=shift.tolist(), shift=float(np.linalg.norm(shift)), tilt_rad=turn)


def _bent(key: str, against: str, found: Apart, limits: Mapping[str, Any]) -> list[str]:
    reasons = []
    if found.shift > limits["max_shift_m"]:
        reasons.append(
            f"{BENT}: {key}.max_shift_m: the point is {1e3 * found.shift:.2f} mm off {against}, "
            f"the limit is {1e3 * limits['max_shift_m']:g} mm"
        )
    if found.tilt_rad > limits["max_tilt_rad"]:
        reasons.append(
            f"{BENT}: {key}.max_tilt_rad: the axis is {DEG * found.tilt_rad:.2f} deg off {against}, "
            f"the limit is {DEG * limits['max_tilt_rad']:.2f} deg"
        )
    return reasons


def _uncertainty_reasons(U: float | None, limit: float) -> list[str]:
    if U is not None and limit < U:
        return [f"max_U_m: 95 % of the errors stay below {1e3 * U:.3g} mm, the limit is {1e3 * limit:g} mm"]
    return []
