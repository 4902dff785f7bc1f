"""How far the calibrated arm will be off at places that were not measured: slices through the workspace."""

from itertools import pairwise
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from cell.poses import Array
from procedures.report.figure import dressed, embed
from procedures.report.html import Html, absent, el, note, section, table
from procedures.report.numbers import mm, mms
from procedures.tracker.report.source import Forecast, KincalSource

_SLICES = 3
_PER_CELL = 8.0  # places on average


def map_section(source: KincalSource) -> Html | None:
    """Slices at three heights and one from the side, each cell with the largest predicted error in it."""
    if source.found is None:
        return None
    title = "Predicted error in the workspace"
    found = source.forecast
    if found is None:
        return section(title, absent("This method gives no covariance, so no error can be predicted."))
    rows = []
    if (stated := source.found.uncertainty.predicted_95) is not None:
        rows = [
            ("at the samples", mm(stated.samples.median), mm(stated.samples.max)),
            ("in their joint ranges", mm(stated.workspace.median), mm(stated.workspace.max)),
        ]
    worst = found.p[int(np.argmax(found.error95))]
    return section(
        title,
        embed(_figure(found), "map", wide=True),
        note(
            f"{len(found.p)} joint vectors spread over the ranges that the samples have. A cell shows the "
            "largest value in it: 95 % of the errors of the reflector's predicted place stay below this, in "
            "any attitude of the flange that was tried. It comes from the covariance of the solution, so it "
            "holds if the model does; the held-out check above is what tests that. The largest of all is "
            f"{mm(float(found.error95.max()))}, at {', '.join(mms(worst))} mm in the base."
        ),
        table((el("span", "95 % of prediction errors below"), "median", "worst"), rows, "lrr"),
        note(
            "For joints of your own: cellward solve kincal PATH --predict FILE; its p_tracker_95 is this "
            "figure there."
        ),
    )


def _figure(found: Forecast) -> Any:
    heights = np.quantile(found.p[:, 2], np.linspace(0.0, 1.0, _SLICES + 1))
    titles = [f"z {low:.2f} to {high:.2f} m" for low, high in pairwise(heights)]
    fig = make_subplots(1, _SLICES + 1, subplot_titles=[*titles, "from the side"], horizontal_spacing=0.055)
    dressed(fig, 330, margin={"l": 56, "r": 10, "t": 30, "b": 44})
    spans = (_span(found.p[:, 0]), _span(found.p[:, 1]))
    count = max(4, int(np.sqrt(len(found.p) / _SLICES / _PER_CELL)))
    for k, (low, high) in enumerate(pairwise(heights)):
        inside = (found.p[:, 2] >= low) & (found.p[:, 2] <= high)
        fig.add_trace(_cells(found.p[inside][:, :2], found.error95[inside], spans, count), 1, k + 1)
        fig.update_xaxes(title_text="x, m", range=spans[0], row=1, col=k + 1)
        anchor = f"x{k + 1}" if k else "x"
        fig.update_yaxes(range=spans[1], scaleanchor=anchor, constrain="domain", row=1, col=k + 1)
    fig.update_yaxes(title_text="y, m", row=1, col=1)
    side = np.column_stack([np.hypot(found.p[:, 0], found.p[:, 1]), found.p[:, 2]])
    spans = (_span(side[:, 0]), _span(side[:, 1]))
    fig.add_trace(_cells(side, found.error95, spans, int(1.5 * count)), 1, _SLICES + 1)
    fig.update_xaxes(title_text="distance from base z, m", range=spans[0], row=1, col=_SLICES + 1)
    anchor = f"x{_SLICES + 1}"
    fig.update_yaxes(
        title_text="z, m", range=spans[1], scaleanchor=anchor, constrain="domain", row=1, col=_SLICES + 1
    )
    bar = {"title": {"text": "mm"}, "thickness": 12, "len": 0.95}
    fig.update_layout(coloraxis={"colorscale": "Cividis", "colorbar": bar})
    fig.update_annotations(font_size=13)
    return fig


def _span(values: Array) -> list[float]:
    margin = 0.03 * max(float(np.ptp(values)), 0.01)
    return [float(values.min()) - margin, float(values.max()) + margin]


def _cells(at: Array, error: Array, spans: tuple[list[float], list[float]], count: int) -> Any:
    """Square cells, ``count`` along the longer side, with the largest ``error`` (n,) m of places ``at``."""
    size = max(high - low for low, high in spans) / count
    shape = [max(1, int(np.ceil((high - low) / size))) for low, high in spans]
    column, row = (np.minimum(((at[:, k] - spans[k][0]) / size).astype(int), shape[k] - 1) for k in range(2))
    largest = np.full((shape[1], shape[0]), -np.inf)
    np.maximum.at(largest, (row, column), error)
    return go.Heatmap(
        x=[round(spans[0][0] + (k + 0.5) * size, 5) for k in range(shape[0])],
        y=[round(spans[1][0] + (k + 0.5) * size, 5) for k in range(shape[1])],
        z=[[None if v == -np.inf else round(1e3 * v, 5) for v in line] for line in largest.tolist()],
        coloraxis="coloraxis",
        hovertemplate="%{x:.2f}, %{y:.2f} m: %{z:.4f} mm<extra></extra>",
        hoverongaps=False,
    )
