"""Plotly figures in the look of the report, and how they get into the page."""

from collections.abc import Sequence
from html import escape
from typing import Any

import plotly.graph_objects as go
import plotly.io as pio
from plotly.offline import get_plotlyjs

from procedures.report.html import Html, el

INK, SOFT, LINE, REJECTED = "#1b2430", "#5b6776", "#e3e7ec", "#b3261e"
BEFORE, NOW = "#1f5fa8", "#d1701c"
PALETTE = ("#1f5fa8", "#d1701c", "#2e8b57", "#7b4fa3", "#008b9a", "#a1497c", "#7a6a1f", "#4d4d4d")
_MARGIN = {"l": 60, "r": 16, "t": 30, "b": 44}
_LEGEND = {"orientation": "h", "y": 1.0, "yanchor": "bottom", "x": 0}
_CONFIG = {
    "displayModeBar": False,
    "responsive": True,
    "showSendToCloud": False,
    "plotlyServerURL": "",
}
# The look comes in as a figure goes into its page: in each figure it takes plotly longer than to draw it.
# Fonts, margins and axes are a part of it.
pio.templates.default = None
_LOOK = pio.templates["simple_white"].to_plotly_json()
_LOOK["layout"] |= {
    "font": {"family": "Segoe UI, Roboto, Arial, DejaVu Sans, sans-serif", "size": 13, "color": INK},
    "paper_bgcolor": "#fff",
    "plot_bgcolor": "#fff",
    "hoverlabel": {"align": "left"},
    "margin": _MARGIN,
    "legend": _LEGEND,
}
for _axis in ("xaxis", "yaxis"):
    _LOOK["layout"][_axis] |= {"gridcolor": LINE, "showgrid": True, "linecolor": SOFT}


def colour(groups: Sequence[int], group: int) -> str:
    """The colour of a placement, the same in every figure."""
    return PALETTE[list(groups).index(group) % len(PALETTE)]


def label(value: object) -> str:
    """Text for a figure: plotly reads it as markup, so it is escaped."""
    return escape(str(value))


def plotly_script() -> str:
    """plotly.js, for the head of the page: once for all figures."""
    script: str = get_plotlyjs()
    return script


def figure(height: int, **layout: Any) -> Any:
    """An empty figure, ``height`` pixels high."""
    return dressed(go.Figure(), height, **layout)


def dressed(fig: Any, height: int, **layout: Any) -> Any:
    """``fig`` (one with several axes, say), ``height`` pixels high."""
    return fig.update_layout(height=height, **layout)


def legend_below(height: int) -> dict[str, Any]:
    """A legend under the titles of the x axes of a figure that is ``height`` pixels high."""
    plot = height - int(_MARGIN["t"]) - int(_MARGIN["b"])
    return {"y": -58.0 / plot, "yanchor": "top"}


def dots(
    x: Any, y: Any, tint: Any, hover: str = "", *, size: float = 7, symbol: Any = "circle", **more: Any
) -> Any:
    """Markers at ``x`` and ``y``; ``hover`` is what plotly says of each, nothing without."""
    marker = {"color": tint, "size": size, "symbol": symbol}
    return go.Scatter(x=x, y=y, mode="markers", marker=marker, **_said(hover), **more)


def polyline(
    x: Any, y: Any, tint: str, hover: str = "", *, width: float = 1.0, dash: str = "solid", **more: Any
) -> Any:
    """A line from point to point."""
    line = {"color": tint, "width": width, "dash": dash}
    return go.Scatter(x=x, y=y, mode="lines", line=line, **_said(hover), **more)


def _said(hover: str) -> dict[str, str]:
    return {"hovertemplate": f"{hover}<extra></extra>"} if hover else {"hoverinfo": "skip"}


def embed(fig: Any, name: str, *, wide: bool = False) -> Html:
    """The figure as a part of the page; a ``wide`` one is moved sideways on a narrow screen, not squeezed.

    Plotly writes ``<`` and ``/`` in data as escapes.
    """
    drawn = fig.to_dict()
    drawn["layout"] = {"template": _LOOK, **drawn["layout"]}
    markup = pio.to_html(
        drawn,
        validate=False,
        full_html=False,
        include_plotlyjs=False,
        include_mathjax=False,
        div_id=name,
        config=_CONFIG,
    )
    return el("div", Html(markup), class_="figure wide" if wide else "figure")
