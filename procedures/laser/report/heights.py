"""The height of the tool's point: what the ways near its end showed, and the first contact that follows."""

from typing import Any

import numpy as np
from plotly.subplots import make_subplots

from calibration.tool_frame.geometry import BEAMS
from procedures.laser.report.edges import NAME, TINT, hover
from procedures.laser.report.near_end import NearEnd
from procedures.laser.report.source import LaserSource
from procedures.report.figure import dots, dressed, embed, legend_below
from procedures.report.html import Html, absent, note, section, table
from procedures.report.numbers import DASH, K95, mms

_SYMBOL = {
    "hit": "circle",
    "miss": "circle-open",
    "hit, one-sided": "diamond",
    "miss, one-sided": "diamond-open",
}
_TALL_PX = 380


def heights_section(source: LaserSource) -> Html | None:
    """Every way near the end over the height, and the first contacts with their intervals."""
    if source.shown is None:
        return None
    title, found = "Height of the point", source.near_end
    if found is None:
        words = "No ways were near the tool's end, so the height of its point is not known."
        return section(title, absent(words))
    stated = (
        "Lines are where the tool's end first meets the beam, by the likelihood of all ways. Bands hold it "
        "in 95 of 100 cases; what is open of the end's shape and of the arm's repeatability is in them. "
    )
    return section(
        title,
        embed(_figure(found), "heights"),
        table(
            ("", "hits", "misses", "of them one-sided", "first contact, mm", "± 95 %, mm"),
            _rows(found),
            "lrrrrr",
        ),
        note(
            "Heights of the reference's point over the beam when it crossed, or went by above. A full mark "
            "met the beam, an open one did not. Diamonds are one-sided: of a way there and back at the same "
            f"height only one met it. {stated if found.contacts else ''}A miss below a hit is no "
            "contradiction: each way is off by the arm's repeatability, and a break may be too short for the "
            "polls. Ways farther from the end are not shown. A longer tool meets the beam from further up."
        ),
    )


def _rows(found: NearEnd) -> list[tuple[str, ...]]:
    rows = []
    for beam in found.spans:
        for current in (False, True):
            ways = found.ways(beam, current)
            contact = found.contacts.get((beam, current))
            if not ways and contact is None:
                continue
            counts = [
                sum(len(own) for word, own in ways.items() if part in word)
                for part in ("hit", "miss", "one-sided")
            ]
            told = [DASH, DASH] if contact is None else mms([contact[0], K95 * contact[1]])
            rows.append((f"beam {beam}, {NAME[current]}", *(str(n) for n in counts), *told))
    return rows


def _figure(found: NearEnd) -> Any:
    fig = make_subplots(1, 2, subplot_titles=[f"beam {b}" for b in BEAMS], horizontal_spacing=0.1)
    dressed(fig, _TALL_PX)
    named: set[str] = set()
    for column, beam in enumerate(BEAMS, start=1):
        fig.update_xaxes(title_text="number of the pass", row=1, col=column)
        if beam not in found.spans:
            continue
        for current in (False, True):
            for trace in _dots(found, beam, current, named):
                fig.add_trace(trace, 1, column)
            if (contact := found.contacts.get((beam, current))) is not None:
                middle, half = 1e3 * contact[0], 1e3 * K95 * contact[1]
                band = {"fillcolor": TINT[current], "opacity": 0.25, "line_width": 0}
                fig.add_hrect(middle - half, middle + half, **band, row=1, col=column)
                fig.add_hline(middle, line_color=TINT[current], line_width=1, row=1, col=column)
        fig.update_yaxes(
            range=[1e3 * h for h in found.spans[beam]],
            title_text="height, mm" if column == 1 else None,
            row=1,
            col=column,
        )
    fig.update_layout(legend=legend_below(_TALL_PX))
    return fig


def _dots(found: NearEnd, beam: str, current: bool, named: set[str]) -> list[Any]:
    traces = []
    passes = found.found.scene.passes
    for word, own in sorted(found.ways(beam, current).items()):
        name = f"{NAME[current]}, {word}"
        traces.append(
            dots(
                [passes[k].index for k in own],
                (1e3 * np.array([found.heights[k] for k in own])).tolist(),
                TINT[current],
                "%{text}<br>%{y:.4f} mm",
                size=8,
                symbol=_SYMBOL[word],
                name=name,
                legendgroup=name,
                showlegend=name not in named,
                text=[hover(found.found, k) for k in own],
            )
        )
        named.add(name)
    return traces
