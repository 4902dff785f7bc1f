"""The edges of every pass, with the interval that holds each, against the edges that were estimated."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from plotly.subplots import make_subplots

from calibration.tool_frame.geometry import BEAMS
from cell.poses import Array
from procedures.laser.report.passes import EdgeEstimate, ShownPasses
from procedures.laser.report.source import LaserSource
from procedures.report.figure import BEFORE, NOW, dots, dressed, embed, label, legend_below, polyline
from procedures.report.html import Html, absent, note, section
from procedures.report.numbers import mm

TINT = {False: BEFORE, True: NOW}
_FAINT = {False: "#a9c1de", True: "#eec5a3"}
NAME = {False: "reference", True: "now"}
SYMBOL = {1: "triangle-right", -1: "triangle-left"}
_ROW_PX, _NEXT_HEIGHT_M, _GAP_ROWS = 7, 0.001, 3


def edges_section(source: LaserSource) -> Html | None:
    """Where the beam changed on each way across it."""
    title = "Edges of every pass"
    found = source.shown
    if found is None or not found.seen.crossings:
        return section(title, absent("There are no edges to draw."))
    return section(
        title,
        embed(_figure(found, source.estimate), "edges"),
        note(
            "One row is one way across a beam, out ▸ or back ◂, the highest at the top. Each short bar "
            "is the interval between two polls in which the beam changed, as the place of the reference's "
            "point, with the delay taken off; zero is the middle of the reference. Thin lines are the edges "
            "as estimated. Where they shift from one height to the next, the tool is tilted against the "
            "reference. Pale rows were not used across the beam; those that met the tool's end alone draw "
            "its shape and tell the height."
        ),
    )


def _figure(found: ShownPasses, estimate: EdgeEstimate | None) -> Any:
    rows = {beam: _rows(found, beam) for beam in BEAMS}
    tall = max(row[-1][0] if row else 0.0 for row in rows.values())
    fig = make_subplots(1, 2, subplot_titles=[f"beam {b}" for b in BEAMS], horizontal_spacing=0.1)
    height = int(150 + _ROW_PX * tall)
    dressed(fig, height)
    named: set[str] = set()
    for column, beam in enumerate(BEAMS, start=1):
        zero = _middle(found, beam)
        for trace in _traces(found, estimate, rows[beam], zero, named):
            fig.add_trace(trace, 1, column)
        first = _first_rows(found, rows[beam])
        fig.update_xaxes(title_text="along the way across, mm", row=1, col=column)
        fig.update_yaxes(
            autorange="reversed",
            tickvals=[y for y, _ in first],
            ticktext=[f"{1e3 * h:.1f}" for _, h in first],
            title_text="height of the reference's point over the beam, mm" if column == 1 else None,
            row=1,
            col=column,
        )
    fig.update_layout(legend=legend_below(height))
    return fig


def _rows(found: ShownPasses, beam: str) -> list[tuple[float, int]]:
    """Row and place of each pass that crossed: highest first, the reference before now."""
    own = [k for current in (False, True) for k in found.of(beam, current) if k in found.seen.crossings]
    own.sort(key=lambda k: -found.heights[k])
    groups: list[list[int]] = []
    for k in own:
        if groups and found.heights[groups[-1][-1]] - found.heights[k] < _NEXT_HEIGHT_M:
            groups[-1].append(k)
        else:
            groups.append([k])
    rows, y = [], 0.0
    for group in groups:
        for k in sorted(group, key=lambda k: (found.scene.passes[k].current, k)):
            rows.append((y, k))
            y += 1.0
        y += _GAP_ROWS
    return rows


def _first_rows(found: ShownPasses, rows: Sequence[tuple[float, int]]) -> list[tuple[float, float]]:
    """Row and height where a new height begins."""
    starts = [i for i, (y, _) in enumerate(rows) if not i or y - rows[i - 1][0] > 1.0]
    return [(rows[i][0], float(found.heights[rows[i][1]])) for i in starts]


def _middle(found: ShownPasses, beam: str) -> float:
    """Mean of the reference's middles, m along the beam's normal; of today's where there is no reference."""
    for current in (False, True):
        used = [k for k in found.of(beam, current) if k in found.used]
        if used:
            return float(np.mean([np.mean(found.seen.crossings[k].middle) for k in used]))
    return 0.0


def _traces(
    found: ShownPasses,
    estimate: EdgeEstimate | None,
    rows: Sequence[tuple[float, int]],
    zero: float,
    named: set[str],
) -> list[Any]:
    traces = []
    for current in (False, True):
        own = [(y, k) for y, k in rows if found.scene.passes[k].current is current]
        used = [(y, k) for y, k in own if k not in found.unused]
        unused = [(y, k) for y, k in own if k in found.unused]
        faint = f"{NAME[current]}, not used"
        for part, tint, name in ((used, TINT[current], NAME[current]), (unused, _FAINT[current], faint)):
            if part:
                traces.append(_bars(found, part, zero, tint, name, name not in named))
                named.add(name)
        traces.append(_lines(found, estimate, used, zero, TINT[current]))
    return traces


def _bars(
    found: ShownPasses, part: Sequence[tuple[float, int]], zero: float, tint: str, name: str, legend: bool
) -> Any:
    x: list[float] = []
    y: list[float] = []
    half: list[float] = []
    marks: list[str] = []
    texts: list[str] = []
    for row, k in part:
        c = found.seen.crossings[k]
        x += (1e3 * (c.middle - zero)).tolist()
        half += (0.5e3 * (c.high - c.low)).tolist()
        y += [row] * c.edges
        marks += [SYMBOL[c.source.direction]] * c.edges
        texts += [hover(found, k)] * c.edges
    return dots(
        x,
        y,
        tint,
        "%{text}<br>%{x:.4f} mm",
        size=5,
        symbol=marks,
        error_x={"array": half, "color": tint, "thickness": 1.6, "width": 0},
        name=name,
        legendgroup=name,
        showlegend=legend,
        text=texts,
    )


def hover(found: ShownPasses, place: int) -> str:
    """Which pass, and why it is not used."""
    p = found.scene.passes[place]
    lines = [label(p.name), "out" if p.direction > 0 else "back"]
    if (why := found.unused.get(place)) is not None:
        lines.append(label(why))
    return "<br>".join(lines)


def _lines(
    found: ShownPasses,
    estimate: EdgeEstimate | None,
    used: Sequence[tuple[float, int]],
    zero: float,
    tint: str,
) -> Any:
    """The estimated edges through the rows of one height; without an estimate their means."""
    x: list[float | None] = []
    y: list[float | None] = []
    for group in _by_height(used):
        at = [_expected(found, estimate, k) for _, k in group]
        rows = at if all(e is not None for e in at) else [found.seen.crossings[k].middle for _, k in group]
        means = np.mean(np.array(rows), axis=0) - zero
        for place in (1e3 * means).tolist():
            x += [place, place, None]
            y += [group[0][0] - 0.8, group[-1][0] + 0.8, None]
    return polyline(x, y, tint, showlegend=False)


def _expected(found: ShownPasses, estimate: EdgeEstimate | None, place: int) -> Array | None:
    return None if estimate is None else estimate.expected(found.seen.crossings[place])


def _by_height(rows: Sequence[tuple[float, int]]) -> list[list[tuple[float, int]]]:
    groups: list[list[tuple[float, int]]] = []
    for row in rows:
        if groups and row[0] - groups[-1][-1][0] <= 1.0:
            groups[-1].append(row)
        else:
            groups.append([row])
    return groups


def residuals_section(source: LaserSource) -> Html | None:
    """How far each edge is off the estimate."""
    found, estimate = source.shown, source.estimate
    if found is None or estimate is None or source.measured is None:
        return None
    left = source.measured.residuals
    fig = make_subplots(1, 2, subplot_titles=[f"beam {b}" for b in BEAMS], horizontal_spacing=0.1)
    dressed(fig, 330)
    named: set[str] = set()
    for column, beam in enumerate(BEAMS, start=1):
        for current in (False, True):
            used = [k for k in found.of(beam, current) if k in found.used]
            if used:
                fig.add_trace(_rest(found, estimate, used, current, NAME[current] not in named), 1, column)
                named.add(NAME[current])
        fig.update_xaxes(title_text="number of the pass", row=1, col=column)
        fig.update_yaxes(title_text="mm" if column == 1 else None, zeroline=True, row=1, col=column)
    fig.update_layout(legend=legend_below(330))
    return section(
        "Edges against the estimate",
        embed(fig, "edge-residuals"),
        note(
            "Middle of each interval less the estimated edge, out ▸ or back ◂; the bar is the interval. "
            "Where polling alone limits the measurement, every bar reaches zero, and the middles scatter by "
            f"{mm(left.expected_m)} RMS; here it is {mm(left.rms_m)}. A residual is not an accuracy."
        ),
    )


def _rest(
    found: ShownPasses, estimate: EdgeEstimate, used: Sequence[int], current: bool, legend: bool
) -> Any:
    x: list[int] = []
    y: list[float] = []
    half: list[float] = []
    marks: list[str] = []
    texts: list[str] = []
    for k in used:
        c = found.seen.crossings[k]
        expected = estimate.expected(c)
        if expected is None:
            continue
        x += [c.source.index] * c.edges
        y += (1e3 * (c.middle - expected)).tolist()
        half += (0.5e3 * (c.high - c.low)).tolist()
        marks += [SYMBOL[c.source.direction]] * c.edges
        texts += [hover(found, k)] * c.edges
    return dots(
        x,
        y,
        TINT[current],
        "%{text}<br>%{y:.4f} mm",
        size=6,
        symbol=marks,
        error_y={"array": half, "color": TINT[current], "thickness": 0.8, "width": 0},
        name=NAME[current],
        legendgroup=NAME[current],
        showlegend=legend,
        text=texts,
    )
