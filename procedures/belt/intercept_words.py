"""Answers about items on a belt in words: what can be met, how sure that is, and what came true."""

from math import sqrt

from cell.formats.result import Covariance
from procedures.belt.result import InterceptResult, QueryAnswer
from procedures.words import mm

MOST_SHOWN = 10


def intercept_lines(found: InterceptResult) -> list[str]:
    """Summary of all answers, then the first of them; lengths in mm."""
    answers = found.result.answers
    known = sum(a.known for a in answers)
    met = sum(a.t_pick is not None for a in answers)
    lines = [f"  method {found.result.method}: {len(answers)} queries, {known} predicted, {met} within reach"]
    for row in found.heldout.travel:
        lines.append(
            f"  belt over {row.horizon:g} s: {mm(row.rms_m)} RMS from the counts that came later "
            f"({row.count})"
        )
    if (later := found.heldout.later_sightings).count:
        lines.append(f"  later sightings: {mm(later.rms_m)} RMS from the predictions ({later.count})")
    if (camera := found.residuals.camera_sigma_m) is not None:
        lines.append(f"  camera {mm(camera)} per axis (residuals are not accuracy)")
    doubts = {(u.id, u.t): u.cov_pick for u in found.uncertainty.answers}
    lines += [_one(a, doubts.get((a.id, a.t))) for a in answers[:MOST_SHOWN]]
    if len(answers) > MOST_SHOWN:
        lines.append(f"    and {len(answers) - MOST_SHOWN} more; --json lists them all")
    return lines


def _one(a: QueryAnswer, cov: Covariance | None) -> str:
    text = f"    {a.id} asked at {a.t:.3f} s: "
    if not a.known:
        return text + "no answer"
    if a.t_pick is None or a.p_pick is None:
        return text + "out of reach"
    x, y = a.p_pick
    doubt = "" if cov is None else f", one standard deviation {mm(sqrt(cov[0][0] + cov[1][1]))}"
    return text + f"contact at {a.t_pick:.3f} s, x, y [{1e3 * x:.2f}, {1e3 * y:.2f}] mm{doubt}"
