"""A hand-eye calibration in words: what was found, how sure it is, and what is expected of a plan."""

from collections.abc import Mapping, Sequence
from typing import Any

from procedures.plan_words import plan_lines
from procedures.words import deg, mm, pose_text, sigma_text

SETUPS = {
    "T_flange_camera": "camera in flange (eye-in-hand)",
    "T_base_camera": "camera in base (eye-to-hand)",
}
MOST_REJECTED_SHOWN = 10


def calibration_name(answer: Mapping[str, Any]) -> str | None:
    """Which of the two poses a hand-eye answer holds."""
    return next((name for name in SETUPS if answer.get(name) is not None), None)


def hand_eye_lines(result: Mapping[str, Any], answer: Mapping[str, Any]) -> list[str]:
    """The pose, its uncertainty, the residuals, and which observations were not used."""
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


def prediction_text(predicted: Mapping[str, Any]) -> str:
    """The expected error of the calibration, and what was assumed for it."""
    assumed = predicted["assuming"]
    return (
        f"expected error below {mm(predicted['error95_t_m'])} and {deg(predicted['error95_r_rad'])} (95 %), "
        f"assuming {assumed['placements']} placements like this one, corners to {assumed['sigma_px']:g} px, "
        f"flange poses to {mm(assumed['sigma_flange_t'])} and {deg(assumed['sigma_flange_r'])}"
    )


def cone_plan_lines(plan: Mapping[str, Any]) -> list[str]:
    """The poses of a cone, and what is expected of them."""
    predicted = plan.get("predicted")
    return plan_lines(plan) + ([prediction_text(predicted)] if predicted else [])
