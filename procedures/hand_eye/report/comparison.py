"""Before and after: the pose that was in effect when the run started against the result."""

from typing import Any

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray
from plotly.subplots import make_subplots

from calibration.hand_eye import se3
from calibration.hand_eye.leave_out import spread_about_mean
from cell.poses import Array
from procedures.hand_eye.report.measured import MeasuredPoses
from procedures.hand_eye.report.source import HandEyeSource
from procedures.report.figure import colour, dressed, embed
from procedures.report.html import Html, absent, note, paragraph, section, table
from procedures.report.numbers import deg, degs, mm, mms


def comparison_section(source: HandEyeSource) -> Html | None:
    """How far the result is from the pose before, and how the target's poses agree under each."""
    X, before = source.X, source.before
    if X is None:
        return None
    title = "Before and after"
    if before is None:
        return section(title, absent("No pose was in effect before, so there is nothing to compare with."))
    words, old = before
    step = se3.inverse(old) @ X
    moved, turned = X[:3, 3] - old[:3, 3], se3.log(step)[3:]
    away = f"{mm(float(np.linalg.norm(moved)))} and {deg(float(np.linalg.norm(turned)))}"
    lines = [
        ("before", *mms(old[:3, 3]), *degs(se3.log(old)[3:])),
        ("now", *mms(X[:3, 3]), *degs(se3.log(X)[3:])),
        ("difference", *mms(moved), *degs(old[:3, :3] @ turned)),
    ]
    head = ("", "x, mm", "y, mm", "z, mm", "rx, °", "ry, °", "rz, °")
    return section(
        title,
        paragraph(f"The result lies {away} from {words} that was in effect when the run started."),
        table(head, lines, "lrrrrrr"),
        *_spreads(source, old, X),
    )


def _spreads(source: HandEyeSource, old: Array, new: Array) -> list[Html]:
    measured = source.measured
    if measured is None:
        return [absent("The data set is not at hand, so the spread under both poses cannot be shown.")]
    rejected = source.rejected
    used = measured.seen & np.array([int(i) not in rejected for i in measured.index])
    if used.sum() < 2:
        return [absent("Fewer than two usable observations: there is no spread to show.")]
    group = measured.group[used]
    _, number = np.unique(group, return_inverse=True)
    rows = []
    away = []
    for words, X in (("before", old), ("now", new)):
        poses = measured.target_poses(X)[used]
        t, r = spread_about_mean(poses, number)
        rows.append((words, mm(_rms(t)), mm(float(t.max())), deg(_rms(r)), deg(float(r.max()))))
        away.append(_deviations(poses, number))
    head = ("target's poses about their mean", "position RMS", "largest", "rotation RMS", "largest")
    frame = source.target_parent
    return [
        table(head, rows, "lrrrr"),
        embed(_figure(measured, away, group), "before-after"),
        note(
            f"Each dot is the target's position in the {frame} as one pose sees it, about the mean of its "
            "placement. With the right camera pose all dots of a placement fall together; what is left is "
            "noise and the arm's own errors. Left and middle have one scale, right is the middle enlarged."
        ),
    ]


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _deviations(poses: Array, number: NDArray[np.intp]) -> Array:
    """Positions (n, 3) about the mean of their group."""
    out = poses[:, :3, 3].copy()
    for g in np.unique(number):
        out[number == g] -= out[number == g].mean(axis=0)
    return np.asarray(out)


def _figure(measured: MeasuredPoses, away: list[Array], group: NDArray[np.int64]) -> Any:
    titles = ("before", "now, same scale", "now, enlarged")
    fig = make_subplots(1, 3, subplot_titles=titles, horizontal_spacing=0.08)
    dressed(fig, 340)
    groups = sorted(set(measured.group.tolist()))
    old, new = (1e3 * a for a in away)
    wide = 1.08 * max(float(np.abs(old).max()), float(np.abs(new).max()))
    near = 1.08 * float(np.abs(new).max())
    for column, (points, limit) in enumerate(((old, wide), (new, wide), (new, near)), start=1):
        for g in groups:
            mine = points[group == g]
            fig.add_trace(
                go.Scatter(
                    x=mine[:, 0],
                    y=mine[:, 1],
                    mode="markers",
                    marker={"color": colour(groups, g), "size": 7, "opacity": 0.8},
                    name=f"placement {g + 1}",
                    showlegend=column == 1,
                    hovertemplate="%{x:.3f}, %{y:.3f} mm<extra></extra>",
                ),
                1,
                column,
            )
        fig.update_xaxes(title_text="x, mm", range=[-limit, limit], row=1, col=column)
        anchor = f"x{column}" if column > 1 else "x"
        fig.update_yaxes(
            title_text="y, mm" if column == 1 else None, range=[-limit, limit], row=1, col=column
        )
        fig.update_yaxes(scaleanchor=anchor, constrain="domain", row=1, col=column)
    fig.update_layout(legend={"y": -0.2, "yanchor": "top"})
    return fig
