"""The search in height: on which ways the tool met the beam and on which it passed above it."""

from typing import Any

import numpy as np
from plotly.subplots import make_subplots

from calibration.tool_frame.geometry import BEAMS
from procedures.laser.report.edges import NAME, TINT, hover
from procedures.laser.report.passes import ShownPasses, bracket
from procedures.laser.report.source import LaserSource
from procedures.report.figure import dots, dressed, embed, legend_below
from procedures.report.html import Html, absent, note, section, table
from procedures.report.numbers import DASH, mms

_NEAR = 1.3  # of the widest search shown; what is measured far below would hide it


def heights_section(source: LaserSource) -> Html | None:
    """Hits and misses over the height, and the bracket that is left."""
    found = source.shown
    if found is None:
        return None
    title = "Height of the point"
    rows = []
    for beam in BEAMS:
        for current in (False, True):
            hit, miss = bracket(found, beam, current)
            if hit is None and miss is None:
                continue
            gap = DASH if hit is None or miss is None else mms([miss - hit])[0]
            ends = [DASH if h is None else mms([h])[0] for h in (hit, miss)]
            rows.append((f"beam {beam}, {NAME[current]}", *ends, gap))
    if not found.chosen.missed:
        words = "No way passed above the beam, so the height of the tool's point is not bracketed."
        return section(title, absent(words))
    return section(
        title,
        embed(_figure(found), "heights"),
        table(("", "highest hit, mm", "lowest miss, mm", "between, mm"), rows, "lrrr"),
        note(
            "Heights of the reference's point over the beam when it crossed, or passed above. A full dot met "
            "the beam, a ring missed it; the bands are what is left between the highest hit and the lowest "
            "miss. A longer tool meets the beam from further up."
        ),
    )


def _figure(found: ShownPasses) -> Any:
    fig = make_subplots(1, 2, subplot_titles=[f"beam {b}" for b in BEAMS], horizontal_spacing=0.1)
    dressed(fig, 330)
    named: set[str] = set()
    for column, beam in enumerate(BEAMS, start=1):
        edges = [h for current in (False, True) for h in bracket(found, beam, current) if h is not None]
        searched = [found.heights[k] for k in found.chosen.missed if found.scene.passes[k].beam == beam]
        top = 1e3 * max([*edges, *searched], default=0.0)
        low = 1e3 * min(edges, default=0.0)
        reach = max(_NEAR * (top - low), 0.02)
        for current in (False, True):
            for trace in _dots(found, beam, current, named):
                fig.add_trace(trace, 1, column)
            hit, miss = bracket(found, beam, current)
            if hit is not None and miss is not None:
                band = {"fillcolor": TINT[current], "opacity": 0.25, "line_width": 0}
                fig.add_hrect(1e3 * hit, 1e3 * miss, **band, row=1, col=column)
        fig.update_yaxes(
            range=[top - reach - 0.05 * reach, top + 0.1 * reach],
            title_text="height, mm" if column == 1 else None,
            row=1,
            col=column,
        )
        fig.update_xaxes(title_text="number of the pass", row=1, col=column)
    fig.update_layout(legend=legend_below(330))
    return fig


def _dots(found: ShownPasses, beam: str, current: bool, named: set[str]) -> list[Any]:
    traces = []
    for places, symbol, word in (
        (found.chosen.hits, "circle", "hit"),
        (found.chosen.missed, "circle-open", "miss"),
    ):
        own = [k for k in found.of(beam, current) if k in places]
        if not own:
            continue
        name = f"{NAME[current]}, {word}"
        traces.append(
            dots(
                [found.scene.passes[k].index for k in own],
                (1e3 * np.array([found.heights[k] for k in own])).tolist(),
                TINT[current],
                "%{text}<br>%{y:.4f} mm",
                size=8,
                symbol=symbol,
                name=name,
                legendgroup=name,
                showlegend=name not in named,
                text=[hover(found, k) for k in own],
            )
        )
        named.add(name)
    return traces
