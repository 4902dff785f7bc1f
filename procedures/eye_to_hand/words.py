"""An eye-to-hand check in words: the standard, the verdict on what was given, and what correcting brings."""

from collections.abc import Mapping
from typing import Any

from procedures.eye_to_hand.result import AxbcAnswer, AxbcResult
from procedures.plan_words import plan_lines
from procedures.words import deg, mm, pose_text, sigma_text

BLAMED = {
    "none": "camera, target and arm as given fit the images",
    "X": "the given hand-eye does not fit the images; the target's place and the arm do",
    "C": "the target is not where it was given on the flange; the given hand-eye fits",
    "arm": "the arm's errors are larger than an arm's are; camera and target fit",
    "cannot-tell": "something given is wrong, and the images cannot tell whether hand-eye, target or arm",
}
WAYS = {"none": "as given", "constant": "a constant", "model": "the arm's model"}


def axbc_lines(found: AxbcResult) -> list[str]:
    """What a person wants to know of it."""
    answer = found.result
    lines = [
        "  base in camera",
        f"  T_camera_base = {pose_text(answer.T_camera_base)}",
        f"  standard uncertainty {sigma_text(answer.cov)}",
        f"  the given hand-eye is off by {_off(answer)}",
        f"  {place_text(answer)}",
        f"  {BLAMED[answer.blamed]}",
        f"  positioning through the given hand-eye: {mm(answer.positioning.t_rms)}, "
        f"{deg(answer.positioning.r_rms)} RMS over {len(answer.places)} poses",
        f"  {correction_text(answer)}",
        *shift_lines(answer),
    ]
    lines += [f"  {part} known by {source}" for part, source in found.uncertainty.priors.items()]
    if answer.commands is not None:
        lines.append(
            f"  commands for {len(answer.commands)} targets, corrected by {WAYS[answer.correction.chosen]}"
        )
        lines += [
            f"    {k}: {'out of reach' if pose is None else pose_text(pose)}"
            for k, pose in enumerate(answer.commands)
        ]
    if answer.rejected:
        lines.append(f"  {len(answer.rejected)} observations were not used:")
        lines += [f"    {r.index}: {r.reason}" for r in answer.rejected[:10]]
    return lines


def place_text(answer: AxbcAnswer) -> str:
    """How far off the target's place is."""
    off = answer.C_offset
    sigma = [sum(off.cov[i][i] for i in part) ** 0.5 for part in (range(3), range(3, 6))]
    return (
        f"C as given is off by {mm(off.t)}, {deg(off.r)} (standard uncertainty {mm(sigma[0])}, "
        f"{deg(sigma[1])})"
    )


def correction_text(answer: AxbcAnswer) -> str:
    """What correcting targets brings, at poses that were not looked at."""
    cv = answer.correction
    told = ", ".join(f"{WAYS[way]} {mm(rms)}" for way, rms in cv.by_way().items() if rms is not None)
    end = (
        "none of them is surely better than none, so targets stay as they are"
        if cv.chosen == "none"
        else f"targets are corrected by {WAYS[cv.chosen]}"
    )
    return f"held-out error of the target: {told} RMS; {end}"


def shift_lines(answer: AxbcAnswer) -> list[str]:
    """The constant as numbers that a robot program can enter, where it is what corrects best."""
    shift = answer.correction.shift
    if answer.correction.chosen != "constant" or shift is None:
        return []
    return [f"  the constant, as a shift of the base frame that targets are commanded in: {pose_text(shift)}"]


def _off(answer: AxbcAnswer) -> str:
    size, sigma = answer.eval, answer.eval_sigma
    return f"{mm(size.t)} +- {mm(2.0 * sigma.t)}, {deg(size.r)} +- {deg(2.0 * sigma.r)} (95 %)"


def axbc_plan_lines(plan: Mapping[str, Any]) -> list[str]:
    """The poses of a check before anything moves."""
    return plan_lines(plan)
