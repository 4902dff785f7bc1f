"""What the solution makes of each edge: residuals, and of edges that it has not seen."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calibration.tool_frame.averaging import design
from calibration.tool_frame.bounds import rows_of
from calibration.tool_frame.crossings import Crossing
from calibration.tool_frame.lateral import Lateral
from calibration.tool_frame.scene import Refused, ToolFrameScene
from calibration.tool_frame.solution import Solution
from cell.poses import Array

FOLDS = 5


@dataclass(frozen=True, eq=False)
class Residuals:
    """``rest`` (n,) m: middle of an edge's interval minus where the solution has it; ``width`` (n,) m of the
    intervals, ``source`` (n,) the place of the pass in the scene."""

    rest: Array
    width: Array
    source: NDArray[np.int64]

    @property
    def rms(self) -> float:
        return float(np.sqrt(np.mean(self.rest**2)))

    @property
    def expected(self) -> float:
        """RMS that a perfect solution has, because an edge is anywhere in its interval."""
        return float(np.sqrt(np.mean(self.width**2) / 12.0))


def own_residuals(solution: Solution) -> Residuals:
    """Of the edges that the solution was made of."""
    lateral = solution.lateral
    rest = lateral.rows.middle - design(lateral.rows) @ lateral.linear
    return Residuals(rest, lateral.rows.width, lateral.rows.source)


def residuals(lateral: Lateral, crossings: Mapping[int, Crossing]) -> Residuals:
    """Of crossings that ``lateral`` has not seen."""
    groups = {k: c.source.beam if c.source.current else "reference" for k, c in crossings.items()}
    rows = rows_of(crossings, groups, lateral.model, lateral.at, lateral.height)
    d = len(lateral.model.names)
    place = {label: d + k for k, label in enumerate(lateral.rows.labels)}
    edges = np.array([lateral.linear[place[label]] for label in rows.labels])
    rest = rows.middle - design(rows) @ np.concatenate([lateral.linear[:d], edges])
    return Residuals(rest, rows.width, rows.source)


def held_out(
    scene: ToolFrameScene, solution: Solution, solve: Callable[[ToolFrameScene], Lateral], folds: int = FOLDS
) -> Residuals | None:
    """Each edge against what ``solve`` finds without the passes of its fold; None where too few are left.

    A way there and the way back that follows it are in one fold. Passes near the tool's end are not judged:
    how wide it is there, they alone tell.
    """
    near = solution.lateral.narrower
    used = sorted(set(solution.lateral.rows.source.tolist()))
    parts = _folds(scene, used, folds)
    found: list[Residuals] = []
    for part in parts:
        keep = [k for k in range(len(scene.passes)) if k not in part]
        try:
            other = solve(scene.take(keep))
        except Refused:
            continue
        known = set(other.rows.labels)
        left = {
            k: solution.seen.crossings[k]
            for k in part
            if k not in near
            and all((scene.passes[k].beam, j) in known for j in range(solution.seen.crossings[k].edges))
        }
        if left:
            # For crossings that were read with the delay of the solution.
            found.append(residuals(replace(other, tau_read=solution.lateral.tau_read), left))
    if not found:
        return None
    return Residuals(
        np.concatenate([f.rest for f in found]),
        np.concatenate([f.width for f in found]),
        np.concatenate([f.source for f in found]),
    )


def _folds(scene: ToolFrameScene, used: Sequence[int], folds: int) -> list[set[int]]:
    """Pairs dealt in turn within each set, beam and height."""
    order = sorted(
        used,
        key=lambda k: (
            scene.passes[k].current,
            scene.passes[k].beam,
            float(scene.passes[k].pose_t[0]),
        ),
    )
    pairs: list[list[int]] = []
    for k in order:
        p = scene.passes[k]
        if pairs and p.direction == -1:
            q = scene.passes[pairs[-1][-1]]
            if len(pairs[-1]) == 1 and q.direction == 1 and (q.beam, q.current) == (p.beam, p.current):
                pairs[-1].append(k)
                continue
        pairs.append([k])
    parts: list[set[int]] = [set() for _ in range(folds)]
    for i, pair in enumerate(pairs):
        parts[i % folds] |= set(pair)
    return [p for p in parts if p]
