"""What else speaks for or against the result: consistency, held-out checks, other solvers, noise, lens."""

import numpy as np

from procedures.hand_eye.report.source import HandEyeSource
from procedures.hand_eye.result import HandEyeAnswer, HandEyeHeldOut, Intrinsics
from procedures.hand_eye.result_spread import Distance, LeftOut, NeighbourBase, NeighbourSpread
from procedures.hand_eye.words import FLOOR_UNKNOWN
from procedures.report.html import Html, absent, bullets, el, facts, note, paragraph, section, table
from procedures.report.numbers import DASH, deg, mm, mms, px
from procedures.words import listed


def consistency_section(source: HandEyeSource) -> Html | None:
    """The two spreads with their noise floors."""
    if source.found is None:
        return None
    answer = source.found.result
    body: list[object] = [
        note(
            "Two consistency figures. The floor is what a perfect arm would show with the same noise and "
            "poses; within 1.3 times the floor a figure says nothing about the arm and counts as not "
            "resolved. They are neither accuracy nor repeatability."
        )
    ]
    body.append(_spread_table(answer))
    body.append(_unweighted_table(answer))
    body.append(_estimates(source, answer))
    return section("Consistency of simple estimates", *body)


def _spread_table(answer: HandEyeAnswer) -> Html:
    plain = answer.as_configured
    rows: list[tuple[object, ...]] = []
    for name, spread, before, needs, meaning in (
        (
            "Within placements",
            answer.spread_within,
            None if plain is None else plain.spread_within,
            "needs three poses in a placement",
            "RMS over the placements of the standard deviation of the simple estimates, one from each three "
            "neighbouring poses.",
        ),
        (
            "Across placements",
            answer.spread_across,
            None if plain is None else plain.spread_across,
            "needs two placements or more",
            "Standard deviation of the means of the placements. It shows errors that change with the arm's "
            "posture.",
        ),
    ):
        if spread is None:
            rows.append((name, DASH, DASH, DASH, needs, meaning))
            continue
        told = DASH if before is None else f"{mm(before.t_norm)}, {deg(before.r)}"
        figure = f"{mm(spread.t_norm)}, {deg(spread.r)}"
        floor, resolved = DASH, FLOOR_UNKNOWN
        if spread.floor_known:
            floor = f"{mm(spread.floor_t)}, {deg(spread.floor_r)}"
            resolved = "resolved" if spread.resolved else "not resolved"
        rows.append((name, told, figure, floor, resolved, el("span", meaning, class_="note")))
    return table(("", "as configured", "with what was found", "noise floor", "", "what it is"), rows)


def _unweighted_table(answer: HandEyeAnswer) -> Html | None:
    """The same two by the classic cone method, over all placements and by place of the stand."""
    classic = answer.neighbour_spread
    if classic is None:
        return None
    parts: list[tuple[str, NeighbourSpread | NeighbourBase]] = [("all placements", classic)]
    parts += [(f"base {int(base) + 1}", part) for base, part in classic.by_base.items()]
    rows = [
        (
            name,
            *(
                DASH if one is None else f"{mm(one.t_norm)}, {deg(one.r)}"
                for one in (part.within, part.across)
            ),
        )
        for name, part in parts
    ]
    head = ("unweighted, as published figures of the cone method", "within placements", "across placements")
    return table(head, rows, "lrr")


def _estimates(source: HandEyeSource, answer: HandEyeAnswer) -> Html | None:
    X = source.X
    if X is None:
        return None
    rows = []
    for group, entry in answer.estimates.items():
        shown = [DASH] * 3 if entry.mean is None else mms(np.array(entry.mean[:3]) - X[:3, 3])
        rows.append((f"placement {int(group) + 1}", entry.triples, entry.skipped, *shown))
    head = ("mean of the simple estimates minus result", "estimates", "skipped", "x, mm", "y, mm", "z, mm")
    return table(head, rows, "lrrrrr")


def _from_all(held: HandEyeHeldOut) -> str:
    """What was found from the poses that are judged, too."""
    if not held.from_all:
        return ""
    return f" Found from all poses, and held: {listed(held.from_all)}."


def held_out_section(source: HandEyeSource) -> Html | None:
    """Figures from camera's poses that were found without what they are judged by."""
    if source.found is None:
        return None
    held, loo = source.found.heldout, source.found.residuals.loo_mean
    meaning = (
        f"The poses were left out in {held.folds} parts. Each part was judged by a "
        "camera's pose from the rest: target's pose, RMS. It has the arm's errors in it at the places that "
        f"were visited.{_from_all(held)}"
    )
    rows: list[tuple[str, object, str]] = [
        (f"Held out, {held.folds} parts, RMS", pair(held.rms), meaning),
        ("Held out, mean", pair(held.mean), "The same as a mean distance."),
    ]
    if held.rejected and held.rms_with_rejected is not None:
        meaning = f"The same with the {held.rejected} poses that the solution left out."
        rows.append(("Held out, with those left out, RMS", pair(held.rms_with_rejected), meaning))
    if held.rms_by_placement is not None and held.rms_by_placement.t is not None:
        meaning = (
            "Each placement of the target judged by a camera's pose from the others, RMS: the arm's errors "
            f"at a place that it was not found from.{_from_all(held)}"
        )
        rows.append(("Held out, by placement, RMS", pair(held.rms_by_placement), meaning))
    meaning = f"Each pose judged by a camera's pose from all others, mean distance.{_from_all(held)}"
    rows.append(("Leave one out, mean", pair(loo), meaning))
    return section("Held-out check", facts(rows))


def pair(value: Distance | LeftOut) -> str:
    """A distance between poses."""
    return f"{mm(value.t)}, {deg(value.r)}"


def cross_check_section(source: HandEyeSource) -> Html | None:
    """X of ordinary solvers beside ours."""
    if source.found is None:
        return None
    title, found = "Cross-check with ordinary solvers", source.found.residuals
    if not found.cross_check:
        return section(title, absent("The result has no cross-check."))
    rows = [("this result", DASH, DASH, mm(found.spread_mean.t), deg(found.spread_mean.r))]
    for method, entry in found.cross_check.items():
        if entry is None:
            rows.append((_method(method), "gave no answer", "", "", ""))
            continue
        away, spread = entry.from_ours, entry.spread_mean
        rows.append((_method(method), mm(away.t), deg(away.r), mm(spread.t), deg(spread.r)))
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
    """The noise levels behind the weights."""
    if source.found is None:
        return None
    noise, excess = source.found.result.noise, source.found.uncertainty.excess
    rows: list[tuple[str, object, str]] = []
    for key, value, name, shown, meaning in (
        ("sigma_px", noise.sigma_px, "Corner noise", px, "One standard deviation of a corner in one image."),
        (
            "sigma_flange_t",
            noise.sigma_flange_t,
            "Flange position noise",
            mm,
            "Error of the arm's reported positions, each axis.",
        ),
        (
            "sigma_flange_r",
            noise.sigma_flange_r,
            "Flange rotation noise",
            deg,
            "Error of the arm's reported rotations, each axis.",
        ),
        (
            "sigma_pose_t",
            noise.sigma_pose_t,
            "Target position noise",
            mm,
            "Error of the given poses of the target, each axis.",
        ),
        (
            "sigma_pose_r",
            noise.sigma_pose_r,
            "Target rotation noise",
            deg,
            "Error of their rotations, each axis.",
        ),
    ):
        if value is not None:
            how = "estimated from these data" if key in noise.estimated else "given"
            rows.append((name, f"{shown(value)} ({how})", meaning))
    if excess is not None:
        meaning = (
            "Factor by which the residuals exceed what the noise levels explain. The covariance, and so "
            "every interval above, is widened by it."
        )
        rows.append(("Excess", f"{np.sqrt(max(excess, 0.0)):.2f}", meaning))
    return section("Noise levels", facts(rows) if rows else absent("The result names no noise levels."))


def intrinsics_section(source: HandEyeSource) -> Html | None:
    """The intrinsics in use, and how well they fit."""
    if source.found is None:
        return None
    answer, fit = source.found.result, px(source.found.residuals.reprojection_rms_px)
    if (used := answer.intrinsics) is not None:
        return section("Intrinsics", *_estimated_lens(used))
    if answer.lens is not None:
        return section("Intrinsics", *_adjusted_lens(answer.lens, fit))
    words = (
        f"The given intrinsics were used. With them the corners of each image fit a pose with {fit} RMS; "
        "the solver compares this with freely estimated intrinsics and says so when they do not fit."
    )
    return section("Intrinsics", paragraph(words))


def _estimated_lens(used: Intrinsics) -> list[object]:
    rows = [
        (name, f"{k:.2f} px", f"± {1.96 * s:.2f} px")
        for name, k, s in zip(("fx", "fy", "cx", "cy"), used.K, used.sigma_K or [], strict=False)
    ]
    return [
        paragraph(f"Estimated from these images, because {used.why}; fit {px(used.rms_px)} RMS."),
        table(("", "estimate", "95 %"), rows, "lrr"),
        _distortion(used),
        note(
            "Errors of the intrinsics shift the camera's pose along its line of sight and are hard to see "
            "in residuals."
        ),
    ]


def _adjusted_lens(lens: Intrinsics, fit: str) -> list[object]:
    """The lens that belongs to the pose: as the camera says, with what was found of it."""
    return [
        paragraph(
            "The given intrinsics were the start; what was found of the lens is below, and the camera's pose "
            f"belongs to it. With it the corners of each image fit a pose with {fit} RMS."
        ),
        note("fx, fy, cx, cy (px): ", el("code", ", ".join(f"{v:.2f}" for v in lens.K))),
        _distortion(lens),
    ]


def _distortion(lens: Intrinsics) -> Html:
    dist = ", ".join(f"{v:.5f}" for v in lens.dist) or "none"
    return note("Distortion, in OpenCV's order: ", el("code", dist))


def observability_section(source: HandEyeSource) -> Html:
    """What the data could not determine, or determine least, in words."""
    title, found = "What the data could not determine", source.found
    if found is None:
        refused = source.known("unobservable") or ["nothing more is known of it"]
        return section(title, bullets(el("b", f"Not determined: {words}") for words in refused))
    seen = found.observability
    lines: list[object] = [el("b", f"Not determined: {words}") for words in seen.unobservable]
    angles = ", ".join(f"{np.degrees(v):.1f}°" for v in seen.rotation_rms_rad)
    lines.append(
        f"The arm turned by {angles} RMS about its three main axes of rotation (in the {seen.axes_frame}). "
        "Two of them must be clearly above zero; the larger they are, the better the position is known."
    )
    lines.append(f"Determined least: {seen.weakest}.")
    if seen.ambiguity is not None:
        lines.append(f"Left open: {seen.ambiguity}.")
    lines.append(
        "Not tested by these data: the arm's accuracy away from the poses visited. A tracker or a "
        "measured point tests that."
    )
    return section(title, bullets(lines))
