"""Where the uncertainty comes from: its causes, how well each was known before, and what was found of it."""

from collections.abc import Mapping, Sequence
from typing import Any

import plotly.graph_objects as go

from procedures.hand_eye.report.source import HandEyeSource
from procedures.hand_eye.result import BudgetPart, HandEyeAnswer, HandEyeResult
from procedures.report.figure import NOW, embed, figure
from procedures.report.html import Html, absent, facts, note, section, table
from procedures.report.numbers import DASH, deg, mm

TITLE = "Where the uncertainty comes from"
_EXACT = "taken as exact: the uncertainty says nothing of it"


def covered(found: HandEyeResult) -> str:
    """What the stated uncertainty covers, for the line that states it."""
    covers = found.uncertainty.covers
    if not covers:
        return "noise alone; arm, lens and target are taken as exact"
    arm = "" if "arm" in covers else "; the arm is taken as exact"
    return f"noise, {', '.join(covers)}{arm}"


def budget_section(source: HandEyeSource) -> Html | None:
    """The parts of the uncertainty, largest first, and what was found of arm, lens and target."""
    found = source.found
    if found is None:
        return None
    if not found.result.budget:
        return section(
            TITLE,
            absent(
                "This method takes arm, lens and target as exact, so all of the stated uncertainty is noise. "
                "Method adjustment has their errors as unknowns."
            ),
        )
    priors = found.uncertainty.priors or {}
    parts = sorted(found.result.budget, key=lambda part: -part.t)
    rows = [(part.block, mm(part.t), deg(part.r), _known(priors, part.block)) for part in parts]
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
        facts(_found(found.result)),
    )


def _known(priors: Mapping[str, str], block: str) -> str:
    return "the data, or as given" if block == "noise" else priors.get(block, _EXACT)


def _figure(parts: Sequence[BudgetPart]) -> Any:
    fig = figure(60 + 34 * len(parts), showlegend=False)
    lengths = [1e3 * part.t for part in parts]
    fig.add_trace(go.Bar(x=lengths, y=[part.block for part in parts], orientation="h", marker_color=NOW))
    fig.update_yaxes(autorange="reversed")
    fig.update_xaxes(title_text="standard uncertainty of the position, mm")
    return fig


def _found(answer: HandEyeAnswer) -> list[tuple[str, object, str]]:
    rows: list[tuple[str, object, str]] = []
    if (scale := answer.target_scale) is not None:
        for axis, value, sigma in (("x", scale.x, scale.sigma_x), ("y", scale.y, scale.sigma_y)):
            meaning = "How much larger the target is than stated."
            rows.append((f"Printed size along {axis}", _share(value, sigma), meaning))
    if (focal := (answer.unknowns or {}).get("lens", {}).get("focal")) is not None:
        told = _share(focal.value, focal.sigma)
        rows.append(("Focal length", told, "How much longer it is than the camera says."))
    if answer.arm is not None:
        meaning = "RMS error of the flange over all joints that the arm reaches."
        for name, off in (("by its model", answer.arm.configured), ("as corrected", answer.arm.corrected)):
            rows.append((f"Arm {name}", f"{mm(off.t)}, {deg(off.r)}", meaning))
    if (accuracy := answer.absolute_accuracy) is not None:
        rows += [
            (
                "Position error before",
                mm(accuracy.before),
                "RMS at the joints of this capture, by the configured model.",
            ),
            (
                "Position error after",
                mm(accuracy.after),
                "RMS that is expected to remain with the corrected arm.",
            ),
            (
                "Position error after, 95 %",
                mm(accuracy.predicted_95),
                "95 % of the errors that remain are below this.",
            ),
        ]
    if (task := answer.task) is not None:
        meaning = "95 % of the errors of a point that the camera locates there are below this."
        for name, length in (("as configured", task.configured95), ("as corrected", task.corrected95)):
            rows.append((f"At the task's place, arm {name}", mm(length), meaning))
        if task.clearance_m is not None:
            meaning = "What the task leaves free, and the grade."
            rows.append(("Clearance of the task", f"{mm(task.clearance_m)}: {task.grade}", meaning))
    return rows or [("Found", DASH, "The result lists no unknowns.")]


def _share(value: float, sigma: float) -> str:
    return f"{100 * value:+.3f} % ± {196 * sigma:.3f} %"
