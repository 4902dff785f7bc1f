"""Where everything stood: cameras and boards in the base, in space and in two plain views."""

from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from cell.poses import Array
from procedures.hand_eye.report.measured import MeasuredPoses
from procedures.hand_eye.report.source import HandEyeSource
from procedures.report.figure import REJECTED, colour, dressed, embed, figure, polyline
from procedures.report.html import Html, absent, note, section
from procedures.report.space import base_axes, lines, space, with_gaps


def scene_section(source: HandEyeSource) -> Html:
    """The poses in space; the two plain views follow in :func:`views_section`."""
    measured = source.measured
    title = "The poses in space"
    if measured is None:
        return section(title, absent("The capture data set is not at hand, so the poses cannot be drawn."))
    if source.X is None:
        words = (
            "Axes of the flange at each pose in the base; without an answer the camera's place is unknown."
        )
    elif measured.setup == "eye-in-hand":
        words = "The camera at each pose and the target of each placement, in the base."
    else:
        words = "The fixed camera, and the target at each pose of the arm, in the base."
    words += " One colour per placement; poses that were not used are crossed red. Drag to turn."
    return section(title, embed(_scene(source, measured), "scene"), note(words), name="space")


def camera_poses(source: HandEyeSource, measured: MeasuredPoses) -> Array:
    """T_base_camera (n, 4, 4) of each observation; the flange where there is no answer."""
    X = source.X
    if X is None:
        return measured.F
    if measured.setup == "eye-in-hand":
        return np.asarray(measured.F @ X)
    return np.broadcast_to(X, measured.F.shape)


def boards(source: HandEyeSource, measured: MeasuredPoses) -> list[tuple[int, int | None, Array]]:
    """Group, index (None for a placement) and outline (5, 3, closed) of each target in the base."""
    closed = np.vstack([measured.outline, measured.outline[:1]])
    targets = source.targets
    if source.X is None:
        return []
    if measured.setup == "eye-in-hand":
        return [(g, None, closed @ W[:3, :3].T + W[:3, 3]) for g, W in targets.items()]
    found: list[tuple[int, int | None, Array]] = []
    for F, index, group in zip(measured.F, measured.index, measured.group, strict=True):
        if int(group) in targets:
            T = F @ targets[int(group)]
            found.append((int(group), int(index), closed @ T[:3, :3].T + T[:3, 3]))
    return found


def _scene(source: HandEyeSource, measured: MeasuredPoses) -> Any:
    fig = figure(450, margin={"l": 0, "r": 0, "t": 0, "b": 0})
    groups = sorted(set(measured.group.tolist()))
    rejected = source.rejected
    poses = camera_poses(source, measured)
    outlines = boards(source, measured)
    size = _size(poses, outlines)
    fixed = source.X is not None and measured.setup == "eye-to-hand"
    for group in groups:
        rows = [k for k in range(len(poses)) if measured.group[k] == group]
        used = [k for k in rows if int(measured.index[k]) not in rejected]
        tint, name = colour(groups, group), f"placement {group + 1}"
        if not fixed:
            shapes = [_frustum(poses[k], measured.aspect, size) for k in used]
            if source.X is None:
                shapes = [_triad(poses[k], size) for k in used]
            fig.add_trace(lines(shapes, tint, 1.6, name))
        plates = [o for g, index, o in outlines if g == group and index not in rejected]
        fig.add_trace(lines(plates, tint, 5.0 if not fixed else 2.0, f"target, {name}", fixed))
        for plate in plates if not fixed else []:
            fig.add_trace(_plate(plate, tint))
    if fixed:
        fig.add_trace(lines([_frustum(poses[0], measured.aspect, 1.6 * size)], "#1b2430", 4.0, "camera"))
    _add_rejected(fig, source, measured, rejected)
    fig.add_traces(base_axes(3.0 * size))
    corners = np.vstack([poses[:, :3, 3], 3.0 * size * np.eye(3), np.zeros(3), *(o for _, _, o in outlines)])
    fig.update_layout(scene=space(corners, size), showlegend=False)
    return fig


def _size(poses: Array, outlines: list[tuple[int, int | None, Array]]) -> float:
    """Length (m) of a frustum that is seen but does not fill the picture."""
    points = np.vstack([poses[:, :3, 3], *(o for _, _, o in outlines)])
    return max(0.02, 0.045 * float(np.linalg.norm(np.ptp(points, axis=0))))


def _frustum(T: Array, aspect: Array, size: float) -> Array:
    """One path (m, 3) along the edges of a camera's view, from its centre."""
    x, y = aspect * size
    a, b, c, d = (np.array(p) for p in ((-x, -y, size), (x, -y, size), (x, y, size), (-x, y, size)))
    o = np.zeros(3)
    path = np.array([o, a, b, o, b, c, o, c, d, o, d, a])
    return np.asarray(path @ T[:3, :3].T + T[:3, 3])


def _triad(T: Array, size: float) -> Array:
    o = np.zeros(3)
    path = np.array([size * np.eye(3)[0], o, size * np.eye(3)[1], o, size * np.eye(3)[2]])
    return np.asarray(path @ T[:3, :3].T + T[:3, 3])


def _plate(outline: Array, tint: str) -> Any:
    return go.Mesh3d(
        **{k: outline[:4, i] for i, k in enumerate("xyz")},
        i=[0, 0],
        j=[1, 2],
        k=[2, 3],
        color=tint,
        opacity=0.25,
        hoverinfo="skip",
    )


def _add_rejected(fig: Any, source: HandEyeSource, measured: MeasuredPoses, rejected: dict[int, str]) -> None:
    rows = [k for k, index in enumerate(measured.index) if int(index) in rejected]
    if not rows:
        return
    at = camera_poses(source, measured)[rows, :3, 3]
    if measured.setup == "eye-to-hand":
        at = measured.F[rows, :3, 3]
    fig.add_trace(
        go.Scatter3d(
            **{k: at[:, i] for i, k in enumerate("xyz")},
            mode="markers",
            marker={"symbol": "x", "size": 5, "color": REJECTED},
            text=[f"{measured.index[k]}: not used" for k in rows],
            hoverinfo="text",
            name="not used",
        )
    )


def views_section(source: HandEyeSource) -> Html | None:
    """The same from above and from the side, to scale: also readable on paper."""
    measured = source.measured
    if measured is None or source.X is None:
        return None
    fig = make_subplots(
        1, 2, subplot_titles=("from above (x, y)", "from the side (x, z)"), horizontal_spacing=0.1
    )
    dressed(fig, 380)
    groups = sorted(set(measured.group.tolist()))
    rejected = source.rejected
    poses = camera_poses(source, measured)
    outlines = boards(source, measured)
    ray = poses[:, :3, 3] + 1.2 * _size(poses, outlines) * poses[:, :3, 2]
    for column, (a, b) in enumerate(((0, 1), (0, 2)), start=1):
        for group in groups:
            tint = colour(groups, group)
            for unused, shade in ((False, tint), (True, REJECTED)):
                plates = [o[:, [a, b]] for g, i, o in outlines if g == group and (i in rejected) == unused]
                fig.add_trace(_flat(plates, shade, 2.0), 1, column)
            if measured.setup == "eye-to-hand":
                continue
            rows = [k for k in range(len(poses)) if measured.group[k] == group]
            rays = [np.array([poses[k, [a, b], 3], ray[k, [a, b]]]) for k in rows]
            fig.add_trace(_flat(rays, tint, 1.0), 1, column)
            for wanted, symbol, shade in ((True, "circle", tint), (False, "x", REJECTED)):
                at = np.array(
                    [poses[k, [a, b], 3] for k in rows if (int(measured.index[k]) not in rejected) == wanted]
                )
                fig.add_trace(_dots(at.reshape(-1, 2), symbol, shade), 1, column)
        if measured.setup == "eye-to-hand":
            fig.add_trace(_flat([np.array([poses[0, [a, b], 3], ray[0, [a, b]]])], "#1b2430", 2.0), 1, column)
            fig.add_trace(_dots(poses[:1, [a, b], 3], "square", "#1b2430"), 1, column)
        fig.update_xaxes(title_text="x, m", row=1, col=column)
        second = "xyz"[b]
        fig.update_yaxes(
            title_text=f"{second}, m", scaleanchor=f"x{column if column > 1 else ''}", row=1, col=column
        )
    fig.update_layout(showlegend=False)
    words = (
        "A dot is a camera and its line the way it looks"
        if measured.setup == "eye-in-hand"
        else "The square is the camera"
    )
    return section(
        "Two plain views",
        embed(fig, "views"),
        note(f"{words}; the outlines are the targets, red where not used. Base frame, to scale."),
    )


def _flat(shapes: list[Array], tint: str, width: float) -> Any:
    gap = np.full((1, 2), np.nan)
    path = np.vstack([np.vstack([s, gap]) for s in shapes]) if shapes else gap
    x, y = with_gaps(path[:, 0]), with_gaps(path[:, 1])
    return polyline(x, y, tint, width=width)


def _dots(at: Array, symbol: str, tint: str) -> Any:
    return go.Scatter(
        x=at[:, 0], y=at[:, 1], mode="markers", marker={"symbol": symbol, "size": 7, "color": tint}
    )
