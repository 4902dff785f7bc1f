"""A page of a belt while it is picked from: the counts beside what is made of them, and the items."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go

from cell.poses import Array
from procedures.belt.live import AHEAD_S, BELT, COLUMNS, ITEMS
from procedures.report.figure import NOW, PALETTE, SOFT, embed, figure, plotly_script
from procedures.report.html import Html, absent, document, el, join, note, section

_MOST_DOTS = 600
Rows = Mapping[str, Sequence[Sequence[float]]]


def live_page(title: str, rows: Rows, reload_s: float | None) -> str:
    """One HTML document of the ``rows`` of :class:`procedures.belt.live.BeltLive`, by trace."""
    belt, items = (_table(rows, name) for name in (BELT, ITEMS))
    head = el("h1", title)
    if len(belt["t_s"]) < 2:
        return document(title, join([head, absent("No counts yet.")]), "", reload_s)
    end = float(belt["t_s"][-1])
    parts = (_speed_section(belt, end), beside_section(belt, end), _items_section(items, end))
    return document(title, join([head, *parts]), plotly_script(), reload_s)


def _table(rows: Rows, name: str) -> dict[str, Array]:
    columns = COLUMNS[name]
    values = np.array(list(rows.get(name, ())), dtype=float).reshape(-1, len(columns))
    return dict(zip(columns, values.T, strict=True))


def _speed_section(belt: Mapping[str, Array], zero_s: float) -> Html:
    """The belt's speed from two counts each, and as it was estimated at that moment."""
    fig = _figure("m/s")
    t = belt["t_s"] - zero_s
    fig.add_trace(trace(t, belt["raw_m_s"], SOFT, "from two counts", "markers", "m/s"))
    fig.add_trace(trace(t, belt["speed_m_s"], NOW, "estimated", "lines", "m/s"))
    fig.update_yaxes(range=speed_axis(belt["speed_m_s"]))
    return section("Speed of the belt", embed(fig, "speed"))


def speed_axis(believed_m_s: Array) -> list[float]:
    """The ends of an axis for a belt's speed: the estimated speeds with room for scatter, and standstill.

    A speed from two counts that came close together is many times the belt's, and would set the axis.
    """
    known = believed_m_s[np.isfinite(believed_m_s)]
    low, high = (float(min(known)), float(max(known))) if len(known) else (0.0, 0.0)
    low, high = min(low, 0.0), max(high, 0.0)
    room = max(0.25 * (high - low), 0.01)
    return [low - room, high + room]


def beside_section(belt: Mapping[str, Array], zero_s: float) -> Html:
    """Newest counts beside the position that was estimated at their time; ``belt`` has columns ``t_s``,
    ``raw_m`` and ``travel_m`` (k,), times are shown from ``zero_s``."""
    fig = _figure("mm", showlegend=False)
    off = 1e3 * (belt["raw_m"] - belt["travel_m"])
    fig.add_trace(trace(*thinned(belt["t_s"] - zero_s, off), SOFT, "count", "markers", "mm"))
    return section(
        "Counts beside the estimated position",
        embed(fig, "beside"),
        note(
            f"RMS {float(np.sqrt(np.mean(off**2))):.3f} mm. Steps of one count are its rounding; a bow that "
            "lasts says that the belt does what the estimator has not seen yet."
        ),
    )


def _items_section(items: Mapping[str, Array], zero_s: float) -> Html:
    title = "Items along the belt"
    if not len(items["t_s"]):
        return section(title, absent("No item is on its way."))
    fig = _figure("along the belt, mm", showlegend=False)
    for number in np.unique(items["item"]):
        own = items["item"] == number
        t, tint, name = items["t_s"][own] - zero_s, PALETTE[int(number) % len(PALETTE)], f"item {number:.0f}"
        expected = f"{name} as expected {AHEAD_S:g} s before"
        fig.add_trace(trace(t, 1e3 * items["along_m"][own], tint, name, "lines", "mm"))
        fig.add_trace(trace(t + AHEAD_S, 1e3 * items["ahead_m"][own], tint, expected, "markers", "mm"))
    return section(
        title,
        embed(fig, "items"),
        note(
            f"Lines: where items that wait to be picked were. Dots: where they were expected {AHEAD_S:g} s "
            "before; dots beside the lines are errors of the forecast, as of a belt that stopped."
        ),
    )


def _figure(y: str, **layout: Any) -> Any:
    fig = figure(300, **layout)
    fig.update_xaxes(title_text="s")
    fig.update_yaxes(title_text=y)
    return fig


def thinned(x: Array, y: Array) -> tuple[Array, Array]:
    """At most ``_MOST_DOTS`` of the dots, evenly chosen: more do not show, and make a paper of megabytes."""
    step = -(-len(x) // _MOST_DOTS) or 1
    return x[::step], y[::step]


def trace(x: Array, y: Array, tint: str, name: str, mode: str, unit: str) -> Any:
    """Dots or a line of the belt over the time."""
    return go.Scatter(
        x=x,
        y=y,
        mode=mode,
        name=name,
        line={"color": tint, "width": 1.6},
        marker={"color": tint, "size": 3, "opacity": 0.5},
        hovertemplate=f"{name}, %{{x:.2f}} s: %{{y:.4g}} {unit}<extra></extra>",
    )
