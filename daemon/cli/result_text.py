"""A result in words: what was found, how sure it is, and what it does not say."""

from collections.abc import Callable, Mapping, Sequence
from math import degrees, sqrt
from typing import Any

from daemon.cli.belt_text import belt_calibration_lines, belt_tracking_lines
from daemon.cli.intercept_text import intercept_lines
from daemon.cli.iso9283_text import iso9283_lines
from daemon.cli.kincal_text import kincal_lines
from daemon.cli.laser_text import laser_lines, latency_lines, reference_lines
from procedures.words import deg, mm, pose_text

SETUPS = {
    "T_flange_camera": "camera in flange (eye-in-hand)",
    "T_base_camera": "camera in base (eye-to-hand)",
}
MOST_REJECTED_SHOWN = 10


def calibration_name(answer: Mapping[str, Any]) -> str | None:
    """Which of the two poses a hand-eye answer holds."""
    return next((name for name in SETUPS if answer.get(name) is not None), None)


def result_text(result: Mapping[str, Any]) -> str:
    """The summary of a result document; lengths in mm, angles in degrees."""
    lines = [f"{result.get('kind') or 'result'}: verdict {result.get('verdict')}"]
    warnings = result.get("warnings") or []
    told = {warning["text"] for warning in warnings}
    lines += [f"  because: {reason}" for reason in result.get("reasons") or [] if reason not in told]
    answer = result.get("result")
    if answer is None:
        lines.append("  no answer: the data cannot determine it")
    else:
        lines += _BODIES.get(str(result.get("kind")), _hand_eye)(result, answer)
    lines += [f"  warning {w['code']}: {w['text']}" for w in warnings]
    if again := (result.get("inputs") or {}).get("steps_taken_again"):
        lines.append(f"  steps taken again after a short silence of a device: {len(again)}")
        lines += [f"    {entry['step']}: {entry['why']}, {entry['lost_s']:.1f} s lost" for entry in again]
    return "\n".join(lines)


def _hand_eye(result: Mapping[str, Any], answer: Mapping[str, Any]) -> list[str]:
    lines = _answer(answer)
    lines += _residuals(result.get("residuals") or {})
    return lines + _rejected(answer.get("rejected") or [])


def _answer(answer: Mapping[str, Any]) -> list[str]:
    name = calibration_name(answer)
    if name is None:
        return []
    lines = [f"  {SETUPS[name]}", f"  {name} = {pose_text(answer[name])}"]
    if cov := answer.get("cov"):
        lines.append(f"  standard uncertainty {sigma_text(cov)}")
    for key, label in (("spread_within", "spread within"), ("spread_across", "spread across")):
        if spread := answer.get(key):
            lines.append(f"  {label} placements {spread_text(spread)}")
    if any(answer.get(key) for key in ("spread_within", "spread_across")):
        lines.append("  (the two spreads tell how consistent the estimates are, not how accurate)")
    if accuracy := answer.get("absolute_accuracy"):
        lines.append(
            f"  absolute accuracy {mm(accuracy.get('before'))} before, {mm(accuracy.get('after'))} expected "
            f"after, 95 % below {mm(accuracy.get('predicted_95'))}"
        )
    if answer.get("intrinsics"):
        lines.append("  the camera's intrinsics were estimated from the images")
    return lines


def sigma_text(cov: Sequence[Sequence[float]]) -> str:
    """One standard deviation of each component of a pose covariance (6, 6), translation first."""
    sigma = [sqrt(max(cov[i][i], 0.0)) for i in range(6)]
    t = ", ".join(f"{1e3 * s:.4f}" for s in sigma[:3])
    r = ", ".join(f"{degrees(s):.5f}" for s in sigma[3:])
    return f"x, y, z {t} mm; about x, y, z {r} deg"


def spread_text(spread: Mapping[str, Any]) -> str:
    """A consistency figure with the floor that noise alone gives."""
    text = f"{mm(spread.get('t_norm'))}, {deg(spread.get('r'))}"
    if spread.get("floor_t") is not None:
        text += f" (noise alone gives {mm(spread['floor_t'])}, {deg(spread.get('floor_r'))}"
        text += ")" if spread.get("resolved") else ": not resolved)"
    return text


def _residuals(residuals: Mapping[str, Any]) -> list[str]:
    lines = []
    if spread := residuals.get("spread_mean"):
        lines.append(
            f"  mean distance of the target's poses from their mean {mm(spread['t'])}, {deg(spread['r'])}"
        )
    if held_out := residuals.get("loo_mean"):  # empty when leaving one out leaves too few
        lines.append(
            f"  each judged by a solution that did not see it {mm(held_out['t'])}, {deg(held_out['r'])}"
        )
    if (pixels := residuals.get("reprojection_rms_px")) is not None:
        lines.append(f"  reprojection {pixels:.3f} px RMS (residuals are not accuracy)")
    return lines


def _rejected(rejected: Sequence[Mapping[str, Any]]) -> list[str]:
    if not rejected:
        return []
    lines = [f"  {len(rejected)} observations were not used:"]
    lines += [f"    {r['index']}: {r['reason']}" for r in rejected[:MOST_REJECTED_SHOWN]]
    if len(rejected) > MOST_REJECTED_SHOWN:
        lines.append(f"    and {len(rejected) - MOST_REJECTED_SHOWN} more; --json lists them all")
    return lines


_BODIES: dict[str, Callable[[Mapping[str, Any], Mapping[str, Any]], list[str]]] = {
    "belt-calibration": belt_calibration_lines,
    "belt-tracking": belt_tracking_lines,
    "intercept": intercept_lines,
    "iso9283": iso9283_lines,
    "kincal": kincal_lines,
    "laser": laser_lines,
    "laser-reference": reference_lines,
    "latency": latency_lines,
}
