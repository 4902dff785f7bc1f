"""From a pass to a crossing: its edges as intervals of the distance from the beam, ordered in space."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calibration.tool_frame.edges import Bracket, brackets, merged
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
    speed within the crossing, as a share.
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
    """All passes of ``scene``; positions are read ``tau`` s before the polls, where the arm truly was."""
    crossings: dict[int, Crossing] = {}
    missed: list[int] = []
    reasons: dict[int, str] = {}
    for place, found in enumerate(scene.passes):
        edges = brackets(found)
        if found.poll_v[0] or found.poll_v[-1]:
            reasons[place] = "the beam is broken at an end of the way"
        elif not edges:
            missed.append(place)
        else:
            crossings[place] = crossing(scene, frames[found.beam], found, edges, tau)
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
        clean = {k: merged(brackets(scene.passes[k])) for k in own}
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
    low, high, above, at, speeds, noise = [], [], [], [], [], []
    for edge in edges:
        a, b = edge.low - tau, edge.high - tau
        line = _line(t, y, a - WINDOW_S, b + WINDOW_S)
        ends = line.at(np.array([a, b]))
        low.append(float(np.min(ends)))
        high.append(float(np.max(ends)))
        middle = 0.5 * (a + b)
        above.append(float(np.interp(middle, t, h)))
        at.append([float(np.interp(middle, t, x)) for x in found.pose_xyz.T])
        speeds.append(line.slope)
        noise.append(line.scatter)
    v = np.array(speeds)
    order = np.arange(len(edges)) if float(np.sum(v)) >= 0.0 else np.arange(len(edges))[::-1]
    return Crossing(
        source=found,
        low=np.array(low)[order],
        high=np.array(high)[order],
        above=np.array(above)[order],
        at=np.array(at)[order],
        v=v[order],
        soft=np.abs(v[order]) * np.array([e.soft for e in edges])[order],
        rising=np.array([e.rising for e in edges])[order],
        noise=float(np.sqrt(np.mean(np.square(noise)))),
        speed_change=_speed_change(t, y, edges, tau),
    )


@dataclass(frozen=True, eq=False)
class _Line:
    t: Array
    x: Array
    slope: float
    offset: float
    scatter: float
    fitted: bool

    def at(self, t: Array) -> Array:
        found: Array = self.offset + self.slope * t if self.fitted else np.interp(t, self.t, self.x)
        return found


def _line(t: Array, x: Array, begin: float, end: float) -> _Line:
    """A line through the samples within ``begin .. end``; where these are few, between the neighbours."""
    i, j = int(np.searchsorted(t, begin)), int(np.searchsorted(t, end, "right"))
    if j - i < _FEW:
        a, b = np.interp([begin, end], t, x)
        return _Line(t, x, float(b - a) / (end - begin), 0.0, 0.0, False)
    s, y = t[i:j] - t[i], x[i:j]
    ds, dy = s - s.mean(), y - y.mean()
    slope = float(ds @ dy / (ds @ ds))
    rest = dy - slope * ds
    scatter = float(np.sqrt(rest @ rest / (j - i - 2)))
    offset = float(y.mean() - slope * (s.mean() + t[i]))
    return _Line(t, x, slope, offset, scatter, True)


def _speed_change(t: Array, y: Array, edges: Sequence[Bracket], tau: float) -> float:
    """Greatest deviation of the speed from its mean over the crossing, beyond what scatter explains."""
    first, last = edges[0].low - tau, edges[-1].high - tau
    length = last - first
    window = min(SPEED_WINDOW_S, length)
    mean = float(np.interp(last, t, y) - np.interp(first, t, y)) / length
    if mean == 0.0:
        return np.inf
    change = 0.0
    for begin in np.linspace(first, last - window, max(2, int(np.ceil(length / window)))):
        line = _line(t, y, float(begin), float(begin) + window)
        count = max(int(np.count_nonzero((t >= begin) & (t <= begin + window))), 2)
        sigma = line.scatter * np.sqrt(12.0 / count) / window
        change = max(change, (abs(line.slope - mean) - 4.0 * sigma) / abs(mean))
    return float(change)
