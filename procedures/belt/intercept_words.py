"""Answers about items on a belt in words: what can be met, how sure that is, and what came true."""

from collections.abc import Mapping
from math import sqrt
from typing import Any

from procedures.words import mm, told

MOST_SHOWN = 10


def intercept_lines(result: Mapping[str, Any], answer: Mapping[str, Any]) -> list[str]:
    """Summary of all answers, then the first of them; lengths in mm."""
    answers = answer.get("answers") or []
    known = sum(a["pred"][:1] != [[None, None]] for a in answers)
    met = sum(a.get("t_pick") is not None for a in answers)
    lines = [
        f"  method {told(answer.get('method'))}: {len(answers)} queries, {known} predicted, "
        f"{met} within reach"
    ]
    heldout = result.get("heldout") or {}
    for row in heldout.get("travel") or []:
        lines.append(
            f"  belt over {row['horizon']:g} s: {mm(row['rms_m'])} RMS from the counts that came later "
            f"({row['count']})"
        )
    later = heldout.get("later_sightings") or {}
    if later.get("count"):
        lines.append(f"  later sightings: {mm(later['rms_m'])} RMS from the predictions ({later['count']})")
    residuals = result.get("residuals") or {}
    if residuals.get("camera_sigma_m") is not None:
        lines.append(f"  camera {mm(residuals['camera_sigma_m'])} per axis (residuals are not accuracy)")
    covs = (result.get("uncertainty") or {}).get("answers") or []
    doubts = {(u["id"], u["t"]): u.get("cov_pick") for u in covs}
    lines += [_one(a, doubts.get((a["id"], a["t"]))) for a in answers[:MOST_SHOWN]]
    if len(answers) > MOST_SHOWN:
        lines.append(f"    and {len(answers) - MOST_SHOWN} more; --json lists them all")
    return lines


def _one(a: Mapping[str, Any], cov: Any) -> str:
    text = f"    {a['id']} asked at {a['t']:.3f} s: "
    if a["pred"][:1] == [[None, None]]:
        return text + "no answer"
    if a.get("t_pick") is None:
        return text + "out of reach"
    x, y = a["p_pick"]
    doubt = "" if cov is None else f", one standard deviation {mm(sqrt(cov[0][0] + cov[1][1]))}"
    return text + f"contact at {a['t_pick']:.3f} s, x, y [{1e3 * x:.2f}, {1e3 * y:.2f}] mm{doubt}"
