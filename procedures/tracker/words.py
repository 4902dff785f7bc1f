"""The result of a kinematic calibration in words."""

from collections.abc import Mapping, Sequence
from typing import Any

from procedures.words import mm, pose_text

_MOST_SHOWN = 10


def kincal_lines(result: Mapping[str, Any], answer: Mapping[str, Any]) -> list[str]:
    """How far predictions are off before and after, what was determined, and what was left out."""
    held = result.get("heldout") or {}
    lines = [
        "  held-out RMS distance from the tracker's readings:",
        f"    nominal {mm(answer.get('rms_nominal'))}, registration only "
        f"{mm(answer.get('rms_registration_only'))}, calibrated {mm(answer.get('rms_calibrated'), 4)}",
    ]
    if held.get("tracker_3d") is not None:
        lines.append(f"    {_noise(answer)} {mm(held['tracker_3d'], 4)} (sqrt(3) sigma)")
    if aside := held.get("set_aside"):
        off = aside["rms"]
        lines.append(
            f"  {aside['samples']} poses were set aside before solving: nominal {mm(off['nominal'])}, "
            f"registration only {mm(off['registration_only'])}, calibrated {mm(off['calibrated'], 4)}"
        )
    sampling = (result.get("inputs") or {}).get("sampling") or {}
    if stored := sampling.get("stored"):
        lines.append(
            f"  {sampling['measured']} poses were measured and {sampling['set_aside']} of them set aside;"
            f" the rest was solved together with {stored['samples']} of a stored set"
        )
    if looked := sampling.get("monuments"):
        lines.append(
            f"  monuments moved by {mm(looked['max_moved_m'])} at most, the limit is {mm(looked['limit_m'])}"
        )
    predicted = (result.get("uncertainty") or {}).get("predicted_95")
    if predicted:
        everywhere = predicted["workspace"]
        lines.append(
            f"  95 % of prediction errors stay below {mm(predicted['samples']['median'], 4)} at the samples, "
            f"{mm(everywhere['max'], 4)} at the worst place in their range"
        )
    lines.append(f"  T_tracker_base = {pose_text(answer['T_tracker_base'])}")
    lines.append(f"  largest corrections: {_corrections(answer)}")
    observed = result.get("observability") or {}
    count = "" if observed.get("parameters") is None else f"{observed['parameters']} parameters, "
    if (rank := answer.get("rank")) is not None:
        known = answer.get("rank_without_registration")
        more = "" if known is None else f" ({known} with it known)"
        lines.append(f"  {count}rank {rank} with the tracker's place free{more}; not determined alone:")
    lines += [f"    {words}" for words in answer.get("unidentifiable") or []]
    if stopped := answer.get("classic"):
        lines.append(
            f"  the classic method stopped by its {stopped['stopped']} after {stopped['iterations']} steps"
        )
    return lines + _answers(answer) + _rejected(answer.get("rejected") or [])


def _noise(answer: Mapping[str, Any]) -> str:
    """Residuals cannot tell a tracker's noise from what the arm's parameters lack."""
    if (answer.get("noise") or {}).get("given", True):
        return "the tracker's own noise in it is"
    return "the tracker's noise is not given; from the residuals, with all that the model lacks, it is"


def _corrections(answer: Mapping[str, Any]) -> str:
    """The parameters that moved most, in units of the size that a millimetre at a metre's lever has."""
    nominal, found = answer.get("nominal") or {}, answer["parameters"]
    moved = sorted(((abs(v - nominal.get(name, v)), name) for name, v in found.items()), reverse=True)
    texts = []
    for size, name in moved[:4]:
        change = found[name] - nominal[name]
        texts.append(f"{name} {change * 1e3:+.3f} {_unit(name)}" if size else name)
    return ", ".join(texts)


def _unit(name: str) -> str:
    if name.startswith(("theta", "alpha", "beta")) or name in ("t1", "t2", "t3", "t5"):
        return "mrad"
    return "per mille" if name.startswith("k") else "mm"


def _answers(answer: Mapping[str, Any]) -> list[str]:
    lines = []
    if (points := answer.get("p_tracker")) is not None:
        largest = max(answer.get("p_tracker_95") or [0.0], default=0.0)
        sure = f", 95 % of errors below {mm(largest, 4)}" if largest else ""
        lines.append(f"  {len(points)} readings are predicted{sure}; -o FILE or --json holds them")
    if (joints := answer.get("q")) is not None:
        reached = sum(q is not None for q in joints)
        lines.append(f"  joints for {reached} of {len(joints)} wanted poses; -o FILE or --json holds them")
    return lines


def _rejected(rejected: Sequence[Mapping[str, Any]]) -> list[str]:
    if not rejected:
        return []
    lines = [f"  {len(rejected)} samples were not used:"]
    lines += [f"    {r['index']}: {r['reason']}" for r in rejected[:_MOST_SHOWN]]
    if len(rejected) > _MOST_SHOWN:
        lines.append(f"    and {len(rejected) - _MOST_SHOWN} more; --json lists them all")
    return lines
