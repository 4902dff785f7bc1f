"""The first page: the verdict, the answer with its uncertainty, and the limits it is judged by."""

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from calibration.lengths import length95
from procedures.hand_eye.report.budget import covered
from procedures.hand_eye.report.source import HandEyeSource
from procedures.hand_eye.result import HandEyeResult
from procedures.hand_eye.result_spread import PlainSpread
from procedures.hand_eye.words import by_others
from procedures.report.html import Html, absent, el, note, section, table
from procedures.report.numbers import DASH, K95, covariance, deg, degs, dig, mm, mms, number
from procedures.report.verdict import banner, cards

_REMEDY = {
    "too-few-poses": "Take more poses. Three usable ones are the least; 15 to 20 at each placement are good.",
    "poses-not-distinct": "The recorded flange poses are equal. Check that the arm moved between the images "
    "and that the pose was read at each image.",
    "no-rotation": "Turn the flange between poses, about two axes or more, by 15 degrees or more; shifts "
    "alone say nothing about where the camera sits.",
    "parallel-axes": "Add poses that turn the flange about another axis, at right angles to the one used.",
    "rigid-roll": "Keep the camera's roll constant while it goes round the target, or add poses that tilt it "
    "about other axes. A camera that turns with its generatrix cannot be calibrated by any solver.",
}


def verdict_section(source: HandEyeSource) -> Html:
    """The verdict, why, and four figures to take away."""
    top = banner(source, _REMEDY, "Correct what the reason names, take the poses again, and solve again.")
    return top if source.found is None else Html(top + _cards(source.found))


def _cards(found: HandEyeResult) -> Html:
    cov = covariance(found.result.cov)
    t95, r95 = (DASH, DASH) if cov is None else (mm(length95(cov[:3, :3])), deg(length95(cov[3:, 3:])))
    held, made = found.heldout.rms, found.inputs
    return cards(
        (
            (t95, f"95 % of position errors of the camera are below this. Covered: {covered(found)}"),
            (r95, f"95 % of its rotation errors are below this. Covered: {covered(found)}"),
            (
                f"{mm(held.t)}, {deg(held.r)}",
                f"held-out check, RMS: target's poses judged {by_others(found.heldout)}",
            ),
            (
                f"{made.used} of {made.observations}",
                "observations used; each one left out has its reason",
            ),
        )
    )


def result_section(source: HandEyeSource) -> Html:
    """X in millimetres and degrees, with 95 % intervals along the axes of the frame it is given in."""
    X, parent, found = source.X, source.parent, source.found
    title = f"The result: camera in {parent}"
    if X is None or found is None:
        return section(title, absent("There is no answer, so there is no pose to show."))
    rotation = Rotation.from_matrix(X[:3, :3])
    cov = covariance(found.result.cov)
    rows: list[list[object]] = [["position, mm", *mms(X[:3, 3])]]
    if cov is not None:
        turned = X[:3, :3] @ cov[:3, :3] @ X[:3, :3].T
        rows.append(["± 95 %, mm", *mms(K95 * np.sqrt(np.diag(turned)))])
    rows.append(["rotation vector, °", *degs(rotation.as_rotvec())])
    if cov is not None:
        turned = X[:3, :3] @ cov[3:, 3:] @ X[:3, :3].T
        rows.append(
            [
                f"± 95 % about the axes of the {parent}, °",
                *degs(K95 * np.sqrt(np.diag(turned))),
            ]
        )
    quaternion = ", ".join(f"{v:.6f}" for v in rotation.as_quat())
    raw = ", ".join(f"{v:.9g}" for v in (found.result.pose() or ("", []))[1])
    return section(
        title,
        table((el("code", source.name), "x", "y", "z"), rows, "lrrr"),
        note(
            f"The pose of the camera (x right, y down, z forward) in the {parent}: it maps points in the "
            f"camera to points in the {parent}. The intervals come from the covariance of the solution "
            f"(1.96 standard deviations). They cover {covered(found)}. Intervals are not residuals."
            if cov is not None
            else "This method gave no covariance for these data, so no interval can be stated."
        ),
        note("As in files (m, rad): ", el("code", f"[{raw}]")),
        note("Quaternion x, y, z, w: ", el("code", quaternion)),
    )


def limits_section(source: HandEyeSource) -> Html | None:
    """The limits of the job beside the figures they apply to."""
    if source.found is None:
        return None
    limits = dig(source.run, "job_config", "accept")
    cov = covariance(source.found.result.cov)
    classic = source.found.result.neighbour_spread
    figures: list[tuple[str, str, float | None, Callable[[Any], str]]] = [
        (
            "95 % error of the position",
            "max_error_t_m",
            None if cov is None else length95(cov[:3, :3]),
            mm,
        ),
        (
            "95 % error of the rotation",
            "max_error_r_rad",
            None if cov is None else length95(cov[3:, 3:]),
            deg,
        ),
    ]
    for where in ("within", "across"):
        one: PlainSpread | None = getattr(classic, where, None)
        t, r = (None, None) if one is None else (one.t_norm, one.r)
        figures.append((f"unweighted spread {where} placements", f"max_spread_{where}_t_m", t, mm))
        figures.append((f"the same, rotation, {where} placements", f"max_spread_{where}_r_rad", r, deg))
    rows = []
    for name, limit, value, shown in figures:
        most = number(dig(limits, limit))
        if most is not None:
            judged = DASH if value is None else ("within" if value <= most else "beyond")
            rows.append((name, shown(value), shown(most), judged))
    if not rows:
        return section(
            "Limits", absent("No limits were set: this result comes from a data set, not from a job.")
        )
    policy = "accepted by policy when it passes" if dig(limits, "auto") else "accepted by an operator"
    return section(
        "Limits",
        table(("", "this result", "limit", ""), rows, "lrrl"),
        note(f"A result is a proposal until it is {policy}; nothing uses it before."),
    )
