"""From a pass to a crossing: its edges as intervals of the distance from the beam, ordered in space."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.tool_frame.edges import Bracket, merged
from calibration.tool_frame.geometry import BeamFrame
from calibration.tool_frame.scene import Pass, ToolFrameScene
from cell.poses import Array

WINDOW_S = 0.02  # on both sides of an interval: positions there are smoothed by a line
SPEED_WINDOW_S = 0.06
MAX_SPEED_CHANGE = 0.05  # share of the mean speed, between the edges
_FEW = 4


@dataclass(frozen=True, eq=False)
class Crossing:
    """The k edges of one pass, in their order along the beam's ``n``.

    The reference's tool point would be between ``low`` and ``high`` (k,) m along ``n`` at the times of the
    polls around each edge, and ``above`` (k,) m along ``w``; ``at`` (k, 3) m is the flange in the base at the
    middle of the interval; ``v`` (k,) m/s is the signed speed along ``n``,
    ``soft`` (k,) m what the polls' own times leave open, ``rising`` (k,) whether the beam was broken then.
    ``noise`` (m) is the scatter of the poses about lines, ``speed_change`` the greatest deviation of the
    speed within the crossing, as a share. ``near_end`` names the height of a crossing so near the tool's end
    that the tool may be narrower there than further up; it is empty for the others.
    """

    source: Pass
    low: Array
    high: Array
    above: Array
    at: Array
    v: Array
    soft: Array
    rising: Array
    noise: float
    speed_change: float
    near_end: str = ""

    @property
    def edges(self) -> int:
        return len(self.low)

    @property
    def middle(self) -> Array:
        """(k,) m: middle of each interval."""
        return 0.5 * (self.low + self.high)

    @property
    def chord(self) -> float:
        """From the first edge to the last along ``n``, m."""
        return float(self.middle[-1] - self.middle[0])

    @property
    def slack(self) -> float:
        """How far ``chord`` may be off for the intervals' widths alone, m."""
        return 0.5 * float(self.high[0] - self.low[0] + self.high[-1] - self.low[-1])

    @property
    def inwards(self) -> Array:
        """(k,) 1 where a narrower finger has its edge further along ``n``, -1 where it has it less far."""
        found: Array = np.where(np.arange(self.edges) % 2 == 0, 1.0, -1.0)
        return found

    @property
    def speed(self) -> float:
        return float(np.mean(np.abs(self.v)))


@dataclass(frozen=True, eq=False)
class PassContents:
    """What the passes show, each by its place in the scene.

    ``crossings`` met the whole tool and ``partial`` a part of it, of several fingers the longest; ``missed``
    saw nothing. ``reasons`` say why another pass is none of these.
    """

    crossings: Mapping[int, Crossing]
    partial: Sequence[int]
    missed: Sequence[int]
    reasons: Mapping[int, str]


def see(scene: ToolFrameScene, frames: Mapping[str, BeamFrame], tau: float = 0.0) -> PassContents:
    """All passes of ``scene``; positions are read ``tau`` s before the polls, where the arm truly was.

    ``frames`` are those of the scene's beams and tool.
    """
    crossings: dict[int, Crossing] = {}
    missed: list[int] = []
    reasons: dict[int, str] = {}
    for place, found in enumerate(scene.passes):
        edges = found.edges
        if found.poll_v[0] or found.poll_v[-1]:
            reasons[place] = "the beam is broken at an end of the way"
        elif not edges:
            missed.append(place)
        else:
            known = scene.seen.get((found, tau))
            if known is None:
                known = scene.seen[found, tau] = crossing(scene, frames[found.beam], found, edges, tau)
            crossings[place] = known
    partial = _take_bounce_out(scene, frames, crossings, reasons, tau)
    return PassContents(crossings, partial, missed, reasons)


def _take_bounce_out(
    scene: ToolFrameScene,
    frames: Mapping[str, BeamFrame],
    crossings: dict[int, Crossing],
    reasons: dict[int, str],
    tau: float,
) -> list[int]:
    """A pass with another number of edges than the others of its beam is used without bounce, or not.

    Returns those with fewer edges, which met a part of the tool and tell the height.
    """
    partial: list[int] = []
    for beam, frame in frames.items():
        own = [k for k, c in crossings.items() if c.source.beam == beam]
        clean = {k: merged(scene.passes[k].edges) for k in own}
        counts = [len(edges) for edges in clean.values() if edges]
        if not counts:
            continue
        usual = max(set(counts), key=lambda n: (counts.count(n), -n))
        for k in own:
            if crossings[k].edges == usual:
                continue
            if len(clean[k]) == usual:
                crossings[k] = crossing(scene, frame, scene.passes[k], clean[k], tau)
            else:
                if 0 < len(clean[k]) < usual and len(clean[k]) % 2 == 0:
                    partial.append(k)
                del crossings[k]
                reasons[k] = f"the beam changed {len(clean[k])} times, not {usual} as in the other passes"
    return partial


def crossing(
    scene: ToolFrameScene, frame: BeamFrame, found: Pass, edges: Sequence[Bracket], tau: float = 0.0
) -> Crossing:
    """The edges of one pass as intervals along the beam's ``n``."""
    tip = found.pose_xyz + scene.R @ scene.tool.p
    y, h, t = frame.across(tip), frame.above(tip), found.pose_t
    begin, end = np.array([e.low for e in edges]) - tau, np.array([e.high for e in edges]) - tau
    lines = _lines(t, y, begin - WINDOW_S, end + WINDOW_S)
    ends = np.where(
        lines.fitted,
        lines.offset + lines.slope * np.stack([begin, end]),
        np.interp([begin, end], t, y),
    )
    middle, v = 0.5 * (begin + end), lines.slope
    order = np.arange(len(edges)) if float(np.sum(v)) >= 0.0 else np.arange(len(edges))[::-1]
    return Crossing(
        source=found,
        low=np.min(ends, axis=0)[order],
        high=np.max(ends, axis=0)[order],
        above=np.interp(middle, t, h)[order],
        at=np.stack([np.interp(middle, t, x) for x in found.pose_xyz.T], axis=1)[order],
        v=v[order],
        soft=np.abs(v[order]) * np.array([e.soft for e in edges])[order],
        rising=np.array([e.rising for e in edges])[order],
        noise=float(np.sqrt(np.mean(lines.scatter**2))),
        speed_change=_speed_change(t, y, float(begin[0]), float(end[-1])),
    )


@dataclass(frozen=True, eq=False)
class _Lines:
    """Lines through the samples of k windows, ``offset + slope * t``: (k,) each. ``count`` is of the samples;
    where these are few the line is not ``fitted``, and its slope that between the window's ends."""

    slope: Array
    offset: Array
    scatter: Array
    count: NDArray[np.int64]
    fitted: NDArray[np.bool_]


def _lines(t: Array, x: Array, begin: Array, end: Array) -> _Lines:
    """Of the samples ``x`` (n,) at ``t`` (n,) within ``begin .. end`` (k,)."""
    first = np.searchsorted(t, begin)
    count = np.searchsorted(t, end, "right") - first
    fitted = count >= _FEW
    n = np.maximum(count, _FEW)
    at = first[:, None] + np.arange(int(np.max(n)))
    inside = at < (first + count)[:, None]
    at = np.minimum(at, len(t) - 1)
    s, y = np.where(inside, t[at] - begin[:, None], 0.0), np.where(inside, x[at], 0.0)
    s_mean, y_mean = np.sum(s, axis=1) / n, np.sum(y, axis=1) / n
    ds, dy = np.where(inside, s - s_mean[:, None], 0.0), np.where(inside, y - y_mean[:, None], 0.0)
    square = np.where(fitted, np.sum(ds * ds, axis=1), 1.0)
    slope = np.sum(ds * dy, axis=1) / square
    scatter = np.sqrt(np.sum((dy - slope[:, None] * ds) ** 2, axis=1) / (n - 2))
    offset = y_mean - slope * (s_mean + begin)
    between = (np.interp(end, t, x) - np.interp(begin, t, x)) / (end - begin)
    nothing = np.zeros(len(begin))
    return _Lines(
        np.where(fitted, slope, between),
        np.where(fitted, offset, nothing),
        np.where(fitted, scatter, nothing),
        count,
        fitted,
    )


def _speed_change(t: Array, y: Array, first: float, last: float) -> float:
    """Greatest deviation of the speed from its mean over the crossing, from ``first`` to ``last`` (s), beyond
    what scatter explains."""
    length = last - first
    window = min(SPEED_WINDOW_S, length)
    mean = float(np.interp(last, t, y) - np.interp(first, t, y)) / length
    if mean == 0.0:
        return np.inf
    begin = np.linspace(first, last - window, max(2, int(np.ceil(length / window))))
    lines = _lines(t, y, begin, begin + window)
    sigma = lines.scatter * np.sqrt(12.0 / np.maximum(lines.count, 2)) / window
    change = (np.abs(lines.slope - mean) - 4.0 * sigma) / abs(mean)
    return max(float(np.max(change)), 0.0)
