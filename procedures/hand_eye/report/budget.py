"""Where the uncertainty comes from: its causes, how well each was known before, and what was found of it."""

from collections.abc import Mapping, Sequence
from typing import Any

import plotly.graph_objects as go

from procedures.hand_eye.report.source import HandEyeSource
from procedures.report.figure import NOW, embed, figure
from procedures.report.html import Html, absent, facts, note, section, table
from procedures.report.numbers import DASH, deg, dig, mm, number

TITLE = "Where the uncertainty comes from"
_EXACT = "taken as exact: the uncertainty says nothing of it"


def covered(source: HandEyeSource) -> str:
    """What the stated uncertainty covers, for the line that states it."""
    covers = dig(source.result, "uncertainty", "covers")
    if not isinstance(covers, Sequence) or not covers:
        return "noise alone; arm, lens and target are taken as exact"
    arm = "" if "arm" in covers else "; the arm is taken as exact"
    return f"noise, {', '.join(map(str, covers))}{arm}"


def budget_section(source: HandEyeSource) -> Html | None:
    """The parts of the uncertainty, largest first, and what was found of arm, lens and target."""
    if source.answer is None:
        return None
    budget = [part for part in dig(source.answer, "budget") or [] if isinstance(part, Mapping)]
    if not budget:
        return section(
            TITLE,
            absent(
                "This method takes arm, lens and target as exact, so all of the stated uncertainty is noise. "
                "Method adjustment has their errors as unknowns."
            ),
        )
    priors = dig(source.result, "uncertainty", "priors")
    parts = sorted(budget, key=lambda part: -(number(part.get("t")) or 0.0))
    rows = [
        (str(p.get("block")), mm(p.get("t")), deg(p.get("r")), _known(priors, p.get("block"))) for p in parts
    ]
    return section(
        TITLE,
        table(("cause", "position", "rotation", "known before by"), rows, "lrrl"),
        embed(_figure(parts), "budget"),
        note(
            "Standard uncertainty of the camera's pose by cause; the squares add up to the whole. To lower "
            "it, begin with the longest bar: a board that was measured over ten squares (scale_sigma), a "
            "calibrated lens (camera_sigma), more different joints for the arm, more poses for noise. Not "
            "covered: what changes while the poses are taken, a loose bracket, errors on a motor's side of a "
            "gear."
        ),
        facts(_found(source.answer)),
    )


def _known(priors: Any, block: Any) -> str:
    if block == "noise":
        return "the data, or as given"
    return str(dig(priors, str(block)) or _EXACT)


def _figure(parts: Sequence[Mapping[str, Any]]) -> Any:
    fig = figure(60 + 34 * len(parts), showlegend=False)
    lengths = [1e3 * (number(p.get("t")) or 0.0) for p in parts]
    fig.add_trace(
        go.Bar(x=lengths, y=[str(p.get("block")) for p in parts], orientation="h", marker_color=NOW)
    )
    fig.update_yaxes(autorange="reversed")
    fig.update_xaxes(title_text="standard uncertainty of the position, mm")
    return fig


def _found(answer: Mapping[str, Any]) -> list[tuple[str, object, str]]:
    rows: list[tuple[str, object, str]] = []
    scale = dig(answer, "target_scale")
    for axis in "xy":
        if (value := number(dig(scale, axis))) is not None:
            told = f"{100 * value:+.3f} % ± {196 * (number(dig(scale, f'sigma_{axis}')) or 0.0):.3f} %"
            rows.append((f"Printed size along {axis}", told, "How much larger the target is than stated."))
    focal = dig(answer, "unknowns", "lens", "focal")
    if (value := number(dig(focal, "value"))) is not None:
        told = f"{100 * value:+.3f} % ± {196 * (number(dig(focal, 'sigma')) or 0.0):.3f} %"
        rows.append(("Focal length", told, "How much longer it is than the camera says."))
    arm = dig(answer, "arm")
    for key, name in (("configured", "Arm by its model"), ("corrected", "Arm as corrected")):
        if arm is not None:
            told = f"{mm(dig(arm, key, 't'))}, {deg(dig(arm, key, 'r'))}"
            rows.append((name, told, "RMS error of the flange over all joints that the arm reaches."))
    accuracy = dig(answer, "absolute_accuracy")
    for key, name, meaning in (
        ("before", "Position error before", "RMS at the joints of this capture, by the configured model."),
        ("after", "Position error after", "RMS that is expected to remain with the corrected arm."),
        ("predicted_95", "Position error after, 95 %", "95 % of the errors that remain are below this."),
    ):
        if accuracy is not None:
            rows.append((name, mm(dig(accuracy, key)), meaning))
    return rows or [("Found", DASH, "The result lists no unknowns.")]
