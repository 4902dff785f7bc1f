"""The report of an eye-to-hand check: the verdict, the map of the workspace, and what correcting brings."""

from typing import Any

import numpy as np
import plotly.graph_objects as go

from procedures.eye_to_hand.solve.data import FILE_NAME
from procedures.eye_to_hand.words import BLAMED, WAYS
from procedures.report.figure import BEFORE, NOW, embed, figure
from procedures.report.html import Html, absent, el, facts, note, section, table
from procedures.report.layout import Layout, Page
from procedures.report.numbers import deg, dig, mm
from procedures.report.origin import inputs_section
from procedures.report.source import Source
from procedures.report.space import base_axes, lines, space
from procedures.report.timeline import timeline_section
from procedures.report.verdict import banner, cards

_REMEDY = {
    "max_error_t_m": "Calibrate the fixed camera again with cone-capture, then check it again.",
    "max_error_r_rad": "Calibrate the fixed camera again with cone-capture, then check it again.",
}
_LONGEST_M = 0.12  # an arrow of the map


def verdict_section(source: Source) -> Html:
    """The verdict, why, and four figures to take away."""
    top = banner(source, _REMEDY, "Correct what the reason names, and check again.")
    answer = source.answer
    if answer is None:
        return top
    chosen = str(dig(answer, "correction", "chosen"))
    return Html(
        top
        + cards(
            (
                (mm(dig(answer, "eval", "t")), "the given hand-eye is off by, at the base"),
                (deg(dig(answer, "eval", "r")), "and is turned by"),
                (mm(dig(answer, "C_offset", "t")), "the target is off its given place by"),
                (
                    mm(dig(answer, "correction", f"cv_{chosen}")),
                    f"held-out error of the target, corrected by {WAYS.get(chosen, chosen)}",
                ),
            )
        )
    )


def judgement_section(source: Source) -> Html | None:
    """What was given, what the images say of it, and which of it is blamed."""
    answer = source.answer
    if answer is None:
        return None
    rows: list[tuple[str, object, str]] = [
        (
            "Hand-eye as given",
            f"{mm(dig(answer, 'eval', 't'))}, {deg(dig(answer, 'eval', 'r'))}",
            f"Off the standard, which knows it to {mm(dig(answer, 'eval_sigma', 't'))}, "
            f"{deg(dig(answer, 'eval_sigma', 'r'))} (standard deviation).",
        ),
        (
            "Target's place as given",
            f"{mm(dig(answer, 'C_offset', 't'))}, {deg(dig(answer, 'C_offset', 'r'))}",
            "Off the place that images and arm alone find; its error is common to all poses.",
        ),
        (
            "Blamed",
            el("b", str(dig(answer, "blamed"))),
            f"{BLAMED.get(str(dig(answer, 'blamed')), '')}.",
        ),
    ]
    priors = dig(source.result, "uncertainty", "priors") or {}
    rows += [(f"Known of {part}", told, "") for part, told in priors.items()]
    return section("What was given, and what the images say of it", facts(rows))


def map_section(source: Source) -> Html | None:
    """The flange through the camera against the reported one, over the workspace."""
    places = dig(source.answer, "places")
    if source.answer is None:
        return None
    title = "Positioning over the workspace"
    if not isinstance(places, list) or not places:
        return section(title, absent("The result lists no poses."))
    p, d = (np.array([place[key] for place in places], dtype=float) for key in ("p", "d"))
    longest = float(np.linalg.norm(d, axis=1).max())
    scale = _LONGEST_M / longest if longest > 0.0 else 0.0
    fig = figure(480, scene=space(np.vstack([p, p + scale * d, np.zeros((1, 3))]), 0.1))
    fig.add_trace(_dots(p, d))
    fig.add_trace(
        lines([np.array([a, a + scale * b]) for a, b in zip(p, d, strict=True)], NOW, 4.0, "off by")
    )
    for trace in base_axes(0.15):
        fig.add_trace(trace)
    rms = dig(source.answer, "positioning", "t_rms")
    return section(
        title,
        embed(fig, "positioning"),
        note(
            f"Where the given hand-eye sees the flange, less where the arm reports it: {mm(rms)} RMS, "
            f"{mm(longest)} at most. Arrows are {scale:.0f} times as long as what they show."
        ),
    )


def _dots(p: Any, d: Any) -> Any:
    size = 1e3 * np.linalg.norm(d, axis=1)
    return go.Scatter3d(
        x=p[:, 0].tolist(),
        y=p[:, 1].tolist(),
        z=p[:, 2].tolist(),
        mode="markers",
        name="flange",
        marker={"size": 4, "color": BEFORE},
        text=[f"{s:.3f} mm" for s in size],
        hovertemplate="%{text}<extra></extra>",
    )


def correction_section(source: Source) -> Html | None:
    """The three ways to correct targets, at poses that were not looked at."""
    found = dig(source.answer, "correction")
    if found is None:
        return None
    chosen = dig(found, "chosen")
    rows = [
        (
            el("b", words) if way == chosen else words,
            mm(dig(found, f"cv_{way}")),
            "chosen" if way == chosen else "",
        )
        for way, words in WAYS.items()
        if dig(found, f"cv_{way}") is not None
    ]
    return section(
        "Correcting targets",
        table(("way", "held-out error, RMS", ""), rows, "lrl"),
        note(
            "Each fifth of the poses is predicted from the others. A way is only taken when it is surely "
            "better than a simpler one; the noise of a single image is in all of these figures."
        ),
    )


def _page(_source: Source) -> Page[Source]:
    return Page(
        top=(verdict_section, judgement_section),
        left=(map_section,),
        right=(correction_section,),
        rest=(timeline_section, inputs_section),
    )


def _title(_source: Source) -> str:
    return "Eye-to-hand check"


EYE_TO_HAND = Layout(source=Source, data_file=FILE_NAME, title=_title, page=_page)
