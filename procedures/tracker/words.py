"""The result of a kinematic calibration in words."""

from collections.abc import Mapping, Sequence
from typing import Any

from cell.formats.result import Rejected
from procedures.tracker.result import JointErrorSizes, KincalAnswer, KincalResult
from procedures.words import mm, pose_text, told

_MOST_SHOWN = 10


def kincal_lines(found: KincalResult) -> list[str]:
    """How far predictions are off before and after, what was determined, and what was left out."""
    answer, held, sampling = found.result, found.heldout, found.inputs.sampling
    lines = [
        "  held-out RMS distance from the tracker's readings:",
        f"    nominal {mm(answer.rms_nominal)}, registration only {mm(answer.rms_registration_only)}, "
        f"calibrated {mm(answer.rms_calibrated, 4)}",
        f"    {_noise(answer)} {mm(held.tracker_3d, 4)} (sqrt(3) sigma)",
    ]
    if held.rejected and held.rms_with_rejected is not None:
        lines.append(
            f"    with the {held.rejected} rejected samples counted as well, calibrated "
            f"{mm(held.rms_with_rejected, 4)}"
        )
    if held.rms_by_region is not None:
        lines.append(
            "    with a region of the joints' space held out each time, calibrated "
            f"{mm(held.rms_by_region, 4)}"
        )
    if aside := held.set_aside:
        off = aside.rms
        lines.append(
            f"  {aside.samples} poses were set aside before solving: nominal {mm(off.nominal)}, "
            f"registration only {mm(off.registration_only)}, calibrated {mm(off.calibrated, 4)}"
        )
    if sampling and (stored := sampling.stored):
        lines.append(
            f"  {sampling.measured} poses were measured and {sampling.set_aside} of them set aside;"
            f" the rest was solved together with {stored.samples} of a stored set"
        )
    if sampling and (looked := sampling.monuments):
        lines.append(
            f"  monuments moved by {mm(looked.max_moved_m)} at most, the limit is {mm(looked.limit_m)}"
        )
    if predicted := found.uncertainty.predicted_95:
        lines.append(
            "  through noise of the readings 95 % of prediction errors stay below "
            f"{mm(predicted.samples.median, 4)} at the samples, {mm(predicted.workspace.max, 4)} at the "
            f"worst place in their range; {_covered(answer)}"
        )
    if (errors := answer.joint_errors) and (sizes := _joint_errors(errors)):
        lines.append(f"  joints turn beyond what they read, {sizes}; that is in the arm")
    lines += [
        f"  T_tracker_base = {pose_text(answer.T_tracker_base)}",
        f"  largest corrections: {_corrections(answer)}",
        f"  {found.observability.parameters} parameters, rank {answer.rank} with the tracker's place free "
        f"({answer.rank_without_registration} with it known); not determined alone:",
        *(f"    {words}" for words in answer.unidentifiable),
    ]
    if classic := answer.classic:
        lines.append(
            f"  the classic method stopped by its {classic.stopped} after {classic.iterations} steps"
        )
    return lines + _answers(answer) + _rejected(answer.rejected)


def _noise(answer: KincalAnswer) -> str:
    """Residuals cannot tell a tracker's noise from what the arm's parameters lack."""
    if answer.noise.given:
        return "the tracker's own noise in it is"
    return "the tracker's noise is not given; from the residuals, with all that the model lacks, it is"


def _covered(answer: KincalAnswer) -> str:
    """What the stated limit holds for, and what it leaves out."""
    if answer.joint_errors is None:
        return "errors of gears and sag are not in it: by this method, or for want of samples"
    return "errors of gears and sag are in it as the readings show them, backlash and warmth are not"


def _joint_errors(errors: JointErrorSizes) -> str:
    sizes = {"gear errors": errors.gear_rad, "sag": errors.sag_rad}
    return ", ".join(f"{what} of {1e3 * v:.3f} mrad (RMS)" for what, v in sizes.items() if v is not None)


def _corrections(answer: KincalAnswer) -> str:
    """The parameters that moved most, in units of the size that a millimetre at a metre's lever has."""
    nominal, found = answer.nominal, answer.parameters
    geometry = {name: v for name, v in found.items() if not name.startswith(("gear", "sag"))}
    moved = sorted(((abs(v - nominal.get(name, v)), name) for name, v in geometry.items()), reverse=True)
    texts = []
    for size, name in moved[:4]:
        change = found[name] - nominal[name]
        texts.append(f"{name} {change * 1e3:+.3f} {_unit(name)}" if size else name)
    return ", ".join(texts)


def _unit(name: str) -> str:
    if name.startswith(("theta", "alpha", "beta")) or name in ("t1", "t2", "t3", "t5"):
        return "mrad"
    return "per mille" if name.startswith("k") else "mm"


def _answers(answer: KincalAnswer) -> list[str]:
    lines = []
    if (points := answer.p_tracker) is not None:
        largest = max(answer.p_tracker_95 or [0.0], default=0.0)
        sure = f", 95 % of errors below {mm(largest, 4)}" if largest else ""
        lines.append(f"  {len(points)} readings are predicted{sure}; -o FILE or --json holds them")
    if (joints := answer.q) is not None:
        reached = sum(q is not None for q in joints)
        lines.append(f"  joints for {reached} of {len(joints)} wanted poses; -o FILE or --json holds them")
    return lines


def _rejected(rejected: Sequence[Rejected]) -> list[str]:
    if not rejected:
        return []
    lines = [f"  {len(rejected)} samples were not used:"]
    lines += [f"    {r.index}: {r.reason}" for r in rejected[:_MOST_SHOWN]]
    if len(rejected) > _MOST_SHOWN:
        lines.append(f"    and {len(rejected) - _MOST_SHOWN} more; --json lists them all")
    return lines


def kinematics_value(value: Mapping[str, Any]) -> str:
    """Kinematics in the ledger, in a line."""
    before, after = mm(value.get("rms_registration_only")), mm(value.get("rms_calibrated"), 4)
    return (
        f"calibrated arm, {before} off before and {after} after (RMS of {told(value.get('held_out'))} poses "
        f"that were held out), 95 % of errors below {mm(value.get('predicted_95'), 4)}, payload "
        f"{told(value.get('payload_kg'), 'g')} kg"
    )
