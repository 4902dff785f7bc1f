"""The second scan of an update: did the tool's point, with the new frame, meet the reference?"""

from typing import Any

import numpy as np
import plotly.graph_objects as go

from cell.poses import Array
from procedures.laser.report.source import LaserSource, vector
from procedures.report.figure import BEFORE, NOW, SOFT, dots, embed, figure
from procedures.report.html import Html, absent, note, paragraph, section
from procedures.report.numbers import mm, mms


def second_section(source: LaserSource) -> Html | None:
    """None for a run that was no update."""
    update = None if source.measured is None else source.measured.inputs.update
    if update is None:
        return None
    title, second, why = "The new tool frame, tried", update.second_scan, None
    if update.committed is False:
        why = paragraph(f"The new frame was not put into effect: {update.why}.")
    if second is None:
        return section(title, why, absent("There was no second scan with the new tool frame."))
    apart, U = second.apart, second.U_m
    if apart is None or U is None:
        return section(title, why, absent("The second scan could not be solved."))
    verdict = "meets the reference" if second.meets else "does not meet the reference"
    times = " twice, as the first time it missed narrowly" if second.scans == 2 else ""
    at = vector(second.apart_m)
    return section(
        title,
        paragraph(
            f"Scanned again with the new frame{times}, the tool's point {verdict}: it is {mm(apart)} off, "
            f"the limit is {mm(U)}."
        ),
        why,
        None if at is None else embed(_target(at, U), "second"),
        None
        if at is None
        else note(
            "Seen from above, in the plane of the beams: the reference hit in the middle, the tool's point "
            f"of the second scan, and the circle of the limit. In height it is {mms(at[2:])[0]} mm off. The "
            "flange itself is elsewhere than at the reference: that it moves is the correction."
        ),
    )


def _target(at: Array, U: float) -> Any:
    angle = np.linspace(0.0, 2.0 * np.pi, 73)
    fig = figure(340, width=460)
    ring = 1e3 * U * np.column_stack([np.cos(angle), np.sin(angle)])
    fig.add_trace(
        go.Scatter(
            x=ring[:, 0],
            y=ring[:, 1],
            mode="lines",
            line={"color": SOFT, "dash": "dash"},
            name="limit",
            hoverinfo="name",
        )
    )
    for place, tint, name in ((np.zeros(3), BEFORE, "reference hit"), (1e3 * at, NOW, "second scan")):
        fig.add_trace(dots([place[0]], [place[1]], tint, "%{x:.4f}, %{y:.4f} mm", size=11, name=name))
    limit = 1.25e3 * max(U, float(np.abs(at[:2]).max()))
    fig.update_xaxes(title_text="x, mm (base)", range=[-limit, limit])
    fig.update_yaxes(title_text="y, mm (base)", range=[-limit, limit], scaleanchor="x")
    return fig
