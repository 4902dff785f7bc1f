"""What else speaks for or against the result: consistency, held-out checks, other solvers, noise, lens."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from procedures.hand_eye.report.source import HandEyeSource
from procedures.report.html import Html, absent, bullets, el, facts, note, paragraph, section, table
from procedures.report.numbers import DASH, deg, dig, mm, mms, number, px

_SPREADS = (
    (
        "spread_within",
        "Within placements",
        "RMS over the placements of the standard deviation of the simple estimates, one from each three "
        "neighbouring poses.",
    ),
    (
        "spread_across",
        "Across placements",
        "Standard deviation of the means of the placements. It shows errors that change with the arm's "
        "posture.",
    ),
)


def consistency_section(source: HandEyeSource) -> Html | None:
    """The two spreads with their noise floors."""
    if source.answer is None:
        return None
    body: list[object] = [
        note(
            "Two consistency figures. The floor is what a perfect arm would show with the same noise and "
            "poses; within 1.3 times the floor a figure says nothing about the arm and counts as not "
            "resolved. They are neither accuracy nor repeatability."
        )
    ]
    body.append(_spread_table(source.answer))
    body.append(_estimates(source))
    return section("Consistency of simple estimates", *body)


def _spread_table(answer: Any) -> Html:
    rows = []
    for key, name, meaning in _SPREADS:
        spread = dig(answer, key)
        if spread is None:
            why = (
                "needs two placements or more"
                if key == "spread_across"
                else "needs three poses in a placement"
            )
            rows.append((name, DASH, DASH, DASH, why, meaning))
            continue
        resolved = "resolved" if spread.get("resolved") else "not resolved"
        figure = f"{mm(spread.get('t_norm'))}, {deg(spread.get('r'))}"
        floor = f"{mm(spread.get('floor_t'))}, {deg(spread.get('floor_r'))}"
        before = dig(answer, "as_configured", key)
        told = DASH if before is None else f"{mm(before.get('t_norm'))}, {deg(before.get('r'))}"
        rows.append((name, told, figure, floor, resolved, el("span", meaning, class_="note")))
    return table(("", "as configured", "with what was found", "noise floor", "", "what it is"), rows)


def _estimates(source: HandEyeSource) -> Html | None:
    found = dig(source.answer, "estimates")
    X = source.X
    if not isinstance(found, Mapping) or X is None:
        return None
    rows = []
    for group, entry in found.items():
        mean = dig(entry, "mean")
        shown = [DASH] * 3 if not isinstance(mean, list) else mms(np.array(mean[:3]) - X[:3, 3])
        rows.append((_placement(group), _text(dig(entry, "triples")), _text(dig(entry, "skipped")), *shown))
    head = ("mean of the simple estimates minus result", "estimates", "skipped", "x, mm", "y, mm", "z, mm")
    return table(head, rows, "lrrrrr")


def _placement(group: object) -> str:
    name = str(group)
    return f"placement {int(name) + 1}" if name.isdigit() else name


def _text(value: Any) -> str:
    return DASH if value is None else str(value)


def held_out_section(source: HandEyeSource) -> Html | None:
    """Figures from solutions that did not see what they are judged by."""
    if source.answer is None:
        return None
    held, loo = source.result.get("heldout"), dig(source.result, "residuals", "loo_mean")
    rows: list[tuple[str, object, str]] = []
    if dig(held, "rms") is not None:
        meaning = (
            f"The poses were left out in {_text(dig(held, 'folds'))} parts. Each part was judged by a "
            "solution from the rest: target's pose, RMS. It has the arm's errors in it at the places that "
            "were visited."
        )
        rows.append((f"Held out, {_text(dig(held, 'folds'))} parts, RMS", _pair(dig(held, "rms")), meaning))
    if dig(held, "mean") is not None:
        rows.append(("Held out, mean", _pair(dig(held, "mean")), "The same as a mean distance."))
    if dig(held, "rejected"):
        meaning = f"The same with the {_text(dig(held, 'rejected'))} poses that the solution left out."
        rows.append(("Held out, with those left out, RMS", _pair(dig(held, "rms_with_rejected")), meaning))
    if dig(held, "rms_by_placement", "t") is not None:
        meaning = (
            "Each placement of the target judged by a solution from the others, RMS: the arm's errors at a "
            "place that the solution has not seen."
        )
        rows.append(("Held out, by placement, RMS", _pair(dig(held, "rms_by_placement")), meaning))
    if loo is not None:
        meaning = "Each pose judged by a solution from all others, mean distance."
        rows.append(("Leave one out, mean", _pair(loo), meaning))
    body = facts(rows) if rows else absent("The result has no held-out check.")
    return section("Held-out check", body)


def _pair(value: Any) -> str:
    return f"{mm(dig(value, 't'))}, {deg(dig(value, 'r'))}"


def cross_check_section(source: HandEyeSource) -> Html | None:
    """X of ordinary solvers beside ours."""
    found = dig(source.result, "residuals", "cross_check")
    if source.answer is None:
        return None
    title = "Cross-check with ordinary solvers"
    if not isinstance(found, Mapping) or not found:
        return section(title, absent("The result has no cross-check."))
    own = dig(source.result, "residuals", "spread_mean")
    rows = [("this result", DASH, DASH, mm(dig(own, "t")), deg(dig(own, "r")))]
    for method, entry in found.items():
        away, spread = dig(entry, "from_ours"), dig(entry, "spread_mean")
        if entry is None:
            rows.append((_method(method), "gave no answer", "", "", ""))
            continue
        figures = (mm(dig(away, "t")), deg(dig(away, "r")), mm(dig(spread, "t")), deg(dig(spread, "r")))
        rows.append((_method(method), *figures))
    return section(
        title,
        table(
            ("solver", "away from this result", "", "target's poses about their mean", ""),
            rows,
            "lrrrr",
        ),
        note(
            "OpenCV's solvers on the same poses (at most 60, of the largest placement). They weigh all "
            "poses alike, so a distance of a few times the interval above is ordinary; a much larger one "
            "deserves a look at the data. A smaller mean distance alone does not make a better calibration."
        ),
    )


def _method(name: object) -> str:
    return f"{str(name).capitalize()} (OpenCV)"


def noise_section(source: HandEyeSource) -> Html | None:
    """The noise levels behind the weights, and the lens that was used."""
    if source.answer is None:
        return None
    noise = source.answer.get("noise")
    estimated = dig(noise, "estimated") or []
    rows: list[tuple[str, object, str]] = []
    for key, name, shown, meaning in (
        ("sigma_px", "Corner noise", px, "One standard deviation of a corner in one image."),
        ("sigma_flange_t", "Flange position noise", mm, "Error of the arm's reported positions, each axis."),
        ("sigma_flange_r", "Flange rotation noise", deg, "Error of the arm's reported rotations, each axis."),
        ("sigma_pose_t", "Target position noise", mm, "Error of the given poses of the target, each axis."),
        ("sigma_pose_r", "Target rotation noise", deg, "Error of their rotations, each axis."),
    ):
        if (value := dig(noise, key)) is not None:
            how = "estimated from these data" if key in estimated else "given"
            rows.append((name, f"{shown(value)} ({how})", meaning))
    excess = number(dig(source.result, "uncertainty", "excess"))
    if excess is not None:
        meaning = (
            "Factor by which the residuals exceed what the noise levels explain. The covariance, and so "
            "every interval above, is widened by it."
        )
        rows.append(("Excess", f"{np.sqrt(max(excess, 0.0)):.2f}", meaning))
    return section("Noise levels", facts(rows) if rows else absent("The result names no noise levels."))


def intrinsics_section(source: HandEyeSource) -> Html | None:
    """The intrinsics in use, and how well they fit."""
    if source.answer is None:
        return None
    used = source.answer.get("intrinsics")
    if used is None:
        fit = px(dig(source.result, "residuals", "reprojection_rms_px"))
        if (lens := source.answer.get("lens")) is not None:
            return section("Intrinsics", *_adjusted_lens(lens, fit))
        words = (
            f"The given intrinsics were used. With them the corners of each image fit a pose with {fit} RMS; "
            "the solver compares this with freely estimated intrinsics and says so when they do not fit."
        )
        return section("Intrinsics", paragraph(words))
    K, sigma = dig(used, "K") or [], dig(used, "sigma_K") or []
    rows = [
        (name, f"{k:.2f} px", f"± {1.96 * s:.2f} px")
        for name, k, s in zip(("fx", "fy", "cx", "cy"), K, sigma, strict=False)
    ]
    dist = ", ".join(f"{v:.5f}" for v in dig(used, "dist") or []) or "none"
    return section(
        "Intrinsics",
        paragraph(
            f"Estimated from these images, because {_text(dig(used, 'why'))}; fit {px(dig(used, 'rms_px'))} "
            "RMS."
        ),
        table(("", "estimate", "95 %"), rows, "lrr"),
        note("Distortion, in OpenCV's order: ", el("code", dist)),
        note(
            "Errors of the intrinsics shift the camera's pose along its line of sight and are hard to see "
            "in residuals."
        ),
    )


def _adjusted_lens(lens: Any, fit: str) -> list[object]:
    """The lens that belongs to the pose: as the camera says, with what was found of it."""
    K = ", ".join(f"{v:.2f}" for v in dig(lens, "K") or [])
    dist = ", ".join(f"{v:.5f}" for v in dig(lens, "dist") or []) or "none"
    return [
        paragraph(
            "The given intrinsics were the start; what was found of the lens is below, and the camera's pose "
            f"belongs to it. With it the corners of each image fit a pose with {fit} RMS."
        ),
        note("fx, fy, cx, cy (px): ", el("code", K)),
        note("Distortion, in OpenCV's order: ", el("code", dist)),
    ]


def observability_section(source: HandEyeSource) -> Html:
    """What the data could not determine, or determine least, in words."""
    found = source.result.get("observability")
    lines: list[object] = [el("b", f"Not determined: {words}") for words in dig(found, "unobservable") or []]
    rms = dig(found, "rotation_rms_rad")
    if isinstance(rms, list) and rms:
        angles = ", ".join(f"{np.degrees(v):.1f}°" for v in rms)
        frame = _text(dig(found, "axes_frame"))
        lines.append(
            f"The arm turned by {angles} RMS about its three main axes of rotation (in the {frame}). Two of "
            "them must be clearly above zero; the larger they are, the better the position is known."
        )
    if dig(found, "weakest"):
        lines.append(f"Determined least: {dig(found, 'weakest')}.")
    if dig(found, "ambiguity"):
        lines.append(f"Left open: {dig(found, 'ambiguity')}.")
    if source.answer is not None:
        lines.append(
            "Not tested by these data: the arm's accuracy away from the poses visited. A tracker or a "
            "measured point tests that."
        )
    body = bullets(lines) if lines else absent("The result says nothing of observability.")
    return section("What the data could not determine", body)
