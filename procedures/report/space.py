"""Figures in space: axes to one scale that fill the picture, and lines in one trace."""

from typing import Any

import numpy as np
import plotly.graph_objects as go

from cell.poses import Array
from procedures.report.figure import SOFT

_FILL = 1.75  # diagonal of what is shown, in the units of plotly's camera
_AXES = (("x", "#c0392b"), ("y", "#2e8b57"), ("z", "#1f5fa8"))


def space(corners: Array, margin: float) -> dict[str, Any]:
    """Axes to one scale round the points ``corners`` (m, 3), so large that they just fill the picture."""
    low, high = corners.min(axis=0) - margin, corners.max(axis=0) + margin
    ratio = _FILL * (high - low) / np.linalg.norm(high - low)
    axis = {"backgroundcolor": "#fff", "gridcolor": "#e3e7ec", "zerolinecolor": "#c5ccd5", "color": SOFT}
    return {
        "annotations": [
            {
                "x": 0,
                "y": 0,
                "z": 0,
                "text": "base",
                "showarrow": False,
                "yshift": -14,
                "font": {"color": SOFT},
            }
        ],
        "aspectmode": "manual",
        "aspectratio": dict(zip("xyz", ratio.tolist(), strict=True)),
        "camera": {"eye": {"x": 1.0, "y": -1.35, "z": 0.65}, "center": {"x": 0, "y": 0, "z": -0.17}},
        **{
            f"{k}axis": {**axis, "title": {"text": f"{k}, m"}, "range": [low[i], high[i]]}
            for i, k in enumerate("xyz")
        },
    }


def base_axes(length: float) -> list[Any]:
    """The axes of the base, so long (m)."""
    ends = length * np.eye(3)
    return [
        lines([np.array([np.zeros(3), end])], tint, 5.0, f"base {letter}", False)
        for end, (letter, tint) in zip(ends, _AXES, strict=True)
    ]


def lines(shapes: list[Array], tint: str, width: float, name: str, show: bool = True) -> Any:
    """Paths (m, 3) in metres as one trace."""
    gap = np.full((1, 3), np.nan)
    path = np.vstack([np.vstack([s, gap]) for s in shapes]) if shapes else gap
    return go.Scatter3d(
        **{k: with_gaps(path[:, i]) for i, k in enumerate("xyz")},
        mode="lines",
        line={"color": tint, "width": width},
        name=name,
        showlegend=show,
        hoverinfo="name",
    )


def with_gaps(values: Array) -> list[float | None]:
    """Values for plotly, which breaks a line where there is none."""
    return [None if np.isnan(v) else round(float(v), 5) for v in values]
