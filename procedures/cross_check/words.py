"""What has changed in a cell, in words."""

from procedures.cross_check.result import CrossCheckAnswer, CrossCheckResult
from procedures.words import deg, mm

JOINTS = ("base", "shoulder", "elbow", "wrist 1", "wrist 2", "wrist 3")
NAMES = {
    "none": "nothing has changed",
    "tool": "the tool is bent or was moved on the flange",
    "camera": "the camera was moved",
    "joint": "the zero of a joint is off",
    "several": "two of these at once",
}
WHAT_TO_DO = {
    "tool": "Look at the tool; measure it with laser-update, or change it and measure a new reference.",
    "camera": "Look at the camera's mount; calibrate it again with cone-capture.",
    "joint zero": "Do not calibrate tool or camera: have the arm's joint checked first; then all of them are "
    "to be calibrated again.",
    "cannot-tell": "Take a capture of more poses, and the tool in the beams, and compare again.",
}


def said(answer: CrossCheckAnswer) -> str:
    """The verdict in one sentence, beginning with a fixed name."""
    if answer.part == "none":
        return "nothing: neither tool nor camera nor a joint's zero has changed"
    if answer.part == "cannot-tell":
        likely = max(answer.probable, key=lambda name: answer.probable[name])
        return (
            f"cannot-tell: no part alone explains what is seen well enough; most probable "
            f"({100 * answer.probable[likely]:.0f} %): {NAMES[likely]}"
        )
    if answer.part == "joint zero":
        off = f"{deg(answer.r)} +- {deg(answer.r_sigma)}"
        return f"joint-zero: the zero of joint '{answer.joint}' is off by {off}"
    if answer.part == "camera":
        return (
            f"camera: it was moved by {mm(answer.t)} +- {mm(answer.t_sigma)} and turned by "
            f"{deg(answer.r)} +- {deg(answer.r_sigma)}"
        )
    return f"tool: its point has moved on the flange by {mm(answer.t)} +- {mm(answer.t_sigma)}"


def cross_check_lines(found: CrossCheckResult) -> list[str]:
    """What has changed, how probable each explanation is, and what stays open."""
    answer = found.result
    shares = ", ".join(f"{NAMES[name]} {100 * share:.1f} %" for name, share in answer.probable.items())
    lines = [f"  {said(answer)}", f"  how probable: {shares}"]
    if (what := WHAT_TO_DO.get(answer.part)) is not None:
        lines.append(f"  what to do: {what}")
    return [*lines, *(f"  not told: {open_}" for open_ in found.observability.undetermined)]
