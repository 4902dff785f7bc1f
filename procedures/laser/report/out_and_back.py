"""The way out against the way back: what the delay of the signals does, and what varies beside it."""

from typing import Any

import numpy as np
from plotly.subplots import make_subplots

from calibration.tool_frame.geometry import BEAMS
from procedures.laser.report.edges import NAME, TINT
from procedures.laser.report.passes import ShownPasses, pairs
from procedures.laser.report.source import LaserSource
from procedures.report.figure import dots, dressed, embed, legend_below
from procedures.report.html import Html, absent, note, section


def out_and_back_section(source: LaserSource) -> Html | None:
    """Out less back of each pair, with the delay taken off, and delay and hysteresis in words."""
    found = source.shown
    if found is None:
        return None
    title = "Out against back"
    hysteresis_m = None if source.found is None else source.found.result.hysteresis_m
    if not any(pairs(found, beam, current) for beam in BEAMS for current in (False, True)):
        return section(title, absent("No way out has a way back beside it."))
    return section(
        title,
        embed(_figure(found, hysteresis_m or 0.0), "out-back"),
        note(
            "Middle of the way out less that of the way back at once after it, along the way across, with "
            "the delay and the hysteresis taken off. What is left is the width of the intervals between "
            "polls; a trend or a step in it would be a beam, an input or an arm that changes."
        ),
    )


def _figure(found: ShownPasses, hysteresis: float) -> Any:
    fig = make_subplots(1, 2, subplot_titles=[f"beam {b}" for b in BEAMS], horizontal_spacing=0.1)
    dressed(fig, 290)
    named: set[bool] = set()
    for column, beam in enumerate(BEAMS, start=1):
        for current in (False, True):
            own = pairs(found, beam, current)
            apart = [_apart(found, out, back, hysteresis) for out, back in own]
            if not own:
                continue
            fig.add_trace(
                dots(
                    [found.scene.passes[out].index for out, _ in own],
                    [1e3 * d for d, _ in apart],
                    TINT[current],
                    "pass %{x}: %{y:.4f} mm",
                    error_y={"array": [1e3 * half for _, half in apart], "thickness": 1, "width": 0},
                    name=NAME[current],
                    legendgroup=NAME[current],
                    showlegend=current not in named,
                ),
                1,
                column,
            )
            named.add(current)
        fig.update_xaxes(title_text="number of the pass out", row=1, col=column)
        fig.update_yaxes(title_text="mm" if column == 1 else None, zeroline=True, row=1, col=column)
    fig.update_layout(legend=legend_below(290))
    return fig


def _apart(found: ShownPasses, out: int, back: int, hysteresis: float) -> tuple[float, float]:
    """Difference of the middles along the way out, m, and half of the interval that it lies in."""
    a, b = found.seen.crossings[out], found.seen.crossings[back]
    sign = float(np.sign(np.mean(a.v)))
    half = 0.5 * float(np.mean(a.high - a.low) + np.mean(b.high - b.low))
    return sign * float(np.mean(a.middle) - np.mean(b.middle)) - hysteresis, half
