"""An eye-to-hand check in words: the standard, the verdict on what was given, and what correcting brings."""

from collections.abc import Mapping, Sequence
from math import dist
from typing import Any

from cell.formats.axbc import How
from procedures.eye_to_hand.result import AxbcAnswer, AxbcResult, DrivenTargets, SeenAtTarget
from procedures.plan_words import HEADER, joints_text, margins, plan_lines
from procedures.words import deg, mm, pose_text, sigma_text, table

BLAMED = {
    "none": "camera, target and arm as given fit the images",
    "X": "the given hand-eye does not fit the images; the target's place and the arm do",
    "C": "the target is not where it was given on the flange; the given hand-eye fits",
    "arm": "the arm's errors are larger than an arm's are; camera and target fit",
    "cannot-tell": "something given is wrong, and the images cannot tell whether hand-eye, target or arm",
}
HOW_WORDS: Mapping[How, str] = {"given": "as given", "corrected": "corrected"}
TARGETS_HEADER = ("target", "T_base_flange", HEADER[1], *HEADER[3:])
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
    lines += driven_lines(answer.driven)
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


def move_text(target: int, how: How) -> str:
    """One move; ``target`` counts from 0."""
    return f"target {target + 1} {HOW_WORDS[how]}"


def check_text(found: AxbcResult) -> str:
    """The verdict of the check on what was given, for somebody who is about to rely on it."""
    said = {"pass": "The check passed", "warn": "The check has warnings", "fail": "The check FAILED"}
    because = f" ({'; '.join(found.reasons)})" if found.reasons else ""
    blamed = BLAMED[found.result.blamed]
    return f"{said[found.verdict]}{because}: the given hand-eye is off by {_off(found.result)}; {blamed}"


def moves_text(found: AxbcResult, driven: Mapping[str, Any], moves: Sequence[tuple[int, How]]) -> str:
    """The verdict, and what the arm is about to be driven to, for the operator's prompt; ``driven`` as in a
    data set, ``moves`` (target, how) without those that are left out."""
    told, way = [], driven["way"]
    shifts: list[float] = []
    for k, target in enumerate(driven["targets"]):
        said = []
        if (k, "given") in moves:
            said.append(f"as given {pose_text(target['given'])}")
        if (k, "corrected") in moves:
            shifts.append(shift := dist(target["corrected"][:3], target["given"][:3]))
            said.append(f"corrected by {mm(shift)} to {pose_text(target['corrected'])}")
        if said:
            told.append(f"target {k + 1} {', '.join(said)}")
    by = (
        "as given only, since no correction is surely better than none"
        if way == "none"
        else f"as given and corrected by {WAYS[way]}"
    )
    if shifts:
        by += f", which moves them by up to {mm(max(shifts))}"
    left = f"; left out: {'; '.join(driven['lost'])}" if driven["lost"] else ""
    order = ", ".join(move_text(target, how) for target, how in moves)
    if list(moves) != sorted(moves, key=lambda move: (move[0], move[1] != "given")):
        left = f"; since not each way is free, in this order: {order}{left}"
    return (
        f"{check_text(found)}. {len(moves)} {'move' if len(moves) == 1 else 'moves'} to targets, {by}: "
        f"{'; '.join(told)}{left}. Confirm to drive there and see what is off, or skip this"
    )


def driven_lines(driven: DrivenTargets | None) -> list[str]:
    """What was off at each target that the arm was driven to."""
    if driven is None:
        return []
    lines = [f"  targets that were driven to, corrected by {WAYS[driven.way]}, and seen by the camera:"]
    if driven.way == "none":
        lines = ["  targets that were driven to as given, since no correction is surely better than none:"]
    lines += [
        f"    {t.number}: off {seen_text(t.before)} as given"
        + ("" if driven.way == "none" else f", {seen_text(t.after)} corrected")
        for t in driven.targets
    ]
    if driven.better is not None:
        lines.append(f"    {gain_text(driven)}")
    lines.append(f"    {driven.meaning}")
    lines += [f"    not measured: {what}" for what in driven.lost]
    return lines if driven.stands is None else [*lines, f"    not returned: {driven.stands}"]


def gain_text(driven: DrivenTargets) -> str:
    """The verdict on the correction, by targets that were seen both ways."""
    said = "surely nearer than" if driven.better else "not surely nearer than"
    return (
        f"corrected targets are {said} as given: {mm(driven.after_rms_m)} off corrected and "
        f"{mm(driven.before_rms_m)} as given (RMS)"
    )


def seen_text(at: SeenAtTarget | None) -> str:
    """How far off one arrival was, with what is common to all targets in the same line."""
    if at is None:
        return "not measured"
    common = f"{mm(at.common_95_m)} common to all targets, and its own part added in squares"
    return f"{mm(at.off_m)} +- {mm(at.off_95_m)} (95 %: {common})"


def outside_text(outside: str) -> str:
    """Of a target that lies ``outside`` of the poses."""
    return f"outside of the poses ({outside}), so how well it is corrected is not known"


def _off(answer: AxbcAnswer) -> str:
    size, sigma = answer.eval, answer.eval_sigma
    return f"{mm(size.t)} +- {mm(2.0 * sigma.t)}, {deg(size.r)} +- {deg(2.0 * sigma.r)} (95 %)"


def axbc_plan_lines(plan: Mapping[str, Any]) -> list[str]:
    """The poses of a check before anything moves, and its targets."""
    lines = plan_lines(plan)
    if not (targets := plan.get("targets")):
        return lines
    rows = [
        (str(t["number"]), pose_text(t["given"]), joints_text(t["q"]), *margins(t))
        for t in targets
        if not t["why"]
    ]
    lines.append(
        f"{len(rows)} of {len(targets)} targets are driven to after the answer, as given and corrected, in "
        "this order; as given:"
    )
    if rows:
        lines.append(table(TARGETS_HEADER, rows))
    lines += [f"  target {t['number']} is left out: {t['why']}" for t in targets if t["why"]]
    lines += [f"  target {t['number']}: {outside_text(t['outside'])}" for t in targets if t.get("outside")]
    return [
        *lines,
        "corrected: not known before the poses are measured; each is checked and shown before the arm drives",
    ]
