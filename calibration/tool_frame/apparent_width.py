"""Tools that are not as wide in all passes: a cone at two heights, a worn point, a beam that was set anew.

The places of the edges are shared by all passes, so that a width that differs would be taken for noise. Where
it clearly does, the edges of those passes are moved in or out evenly to the width of the reference. That
leaves the middle as it is, and the middle is what tells where the tool is.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from calibration.tool_frame.crossings import Crossing
from calibration.tool_frame.geometry import BEAMS
from cell.poses import Array

_CLEARLY = 5.0  # standard deviations
_FLOOR_M = 1e-5
_LEVEL_GAP_M = 0.003
STATED_RADIUS_M, STATED_SHARE = 5e-4, 0.1  # further off than a beam's thickness and a late input make it


def even_widths(crossings: Mapping[int, Crossing]) -> tuple[dict[int, Crossing], list[tuple[str, str]]]:
    """``crossings`` with one width at each beam, and a warning for each beam where they differed."""
    found = dict(crossings)
    warnings: list[tuple[str, str]] = []
    for beam in BEAMS:
        groups = _groups({k: c for k, c in crossings.items() if c.source.beam == beam})
        if len(groups) < 2:
            continue
        base, sd0 = _places([crossings[k] for k in groups[0]])
        worst = 0.0
        for group in groups[1:]:
            here, sd = _places([crossings[k] for k in group])
            off = here - base
            sigma = np.hypot(np.hypot(sd, sd0), _FLOOR_M)
            if float(np.max(np.abs(off))) <= _CLEARLY * sigma:
                continue
            worst = max(worst, float(off[-1] - off[0]), key=abs)
            for k in group:
                c = crossings[k]
                found[k] = replace(c, low=c.low - off, high=c.high - off, soft=np.hypot(c.soft, sigma))
        if worst != 0.0:
            text = (
                f"the tool is not as wide in all passes across beam {beam}: up to {1e3 * worst:.3f} mm apart"
            )
            warnings.append(("laser.width", f"{text}; the middles are used"))
    return found, warnings


def unlike_stated(edges: Mapping[str, Array], radius: float) -> list[tuple[str, str]]:
    """A warning for each beam at which no part of the tool is as wide as ``radius`` (m) says.

    ``edges`` (k,) m are the places of the tool's edges. They are found and not assumed, so that the point and
    the axis are right all the same; thick beams and inputs that clear late make every tool a little wider.
    """
    found = []
    for beam, e in edges.items():
        seen = 0.5 * np.diff(e)[::2]
        nearest = float(seen[np.argmin(np.abs(seen - radius))])
        if abs(nearest - radius) > STATED_RADIUS_M + STATED_SHARE * radius:
            found.append(
                (
                    "laser.radius",
                    f"tool.radius is {1e3 * radius:.2f} mm, and the chords across beam {beam} are those of a "
                    f"radius of {1e3 * nearest:.2f} mm; the chords are used. Correct tool.radius, or "
                    "look whether it is this tool",
                )
            )
    return found


def _groups(crossings: Mapping[int, Crossing]) -> list[list[int]]:
    """Passes of one set and height together; the reference's first."""
    out: list[list[int]] = []
    for current in (False, True):
        own = sorted(
            (k for k, c in crossings.items() if c.source.current == current and not c.near_end),
            key=lambda k: float(np.mean(crossings[k].above)),
        )
        last = -np.inf
        for k in own:
            height = float(np.mean(crossings[k].above))
            if height - last > _LEVEL_GAP_M:
                out.append([])
            out[-1].append(k)
            last = height
    return out


def _places(crossings: Sequence[Crossing]) -> tuple[Array, float]:
    """Edges about their middle (m,), mean of the passes; and the standard deviation that intervals leave."""
    about = np.array([c.middle - np.mean(c.middle) for c in crossings])
    widths = np.array([c.high - c.low for c in crossings])
    sd = float(np.sqrt(np.mean(widths**2) / 12.0 / len(crossings)))
    return np.mean(about, axis=0), sd
