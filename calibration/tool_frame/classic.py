"""The classic method: the middle of the four edges of one way there and back, and the hit height.

Of each beam the first pass out and back that shows the tool is taken, as the search ends there. The mean of
its rising and falling edges is where the flange was. Its difference to the reference's, along base y for beam
``xs`` and along x for ``ys``, is the offset ``o`` in x and y, and the mean difference of the hit heights is
that in z: ``o = [b_x' - b_x, a_y' - a_y, ((a_z' - a_z) + (b_z' - b_z))/2]``. Beams along the axes of the base
are assumed, and no tilt. As the beam is hit at the same point of the base, the tool's point has moved by
``-R^T o``. The published method adds ``o`` to the tool frame as it stands ("standard + offset"); with the
attitude turned by 180 degrees about x that has the right sign in y and z and doubles the error along x.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from calibration.tool_frame.crossings import PassContents
from calibration.tool_frame.geometry import BEAMS, frames
from calibration.tool_frame.scene import Refused, ToolFrameScene
from cell.poses import Array


@dataclass(frozen=True, eq=False)
class Classic:
    """``offset`` (3,) m of the flange in the base; ``dp`` (3,) m of the tool's point in the flange; ``used``
    the places of the pass out and the pass back, by set and beam."""

    offset: Array
    dp: Array
    used: Mapping[str, tuple[int, int]]

    @property
    def source_rule(self) -> Array:
        """(3,) m: what the published method adds to the tool's point. Of the wrong sign; never applied."""
        return self.offset


def solve_classic(scene: ToolFrameScene, seen: PassContents) -> Classic:
    """``seen`` is what the passes show; refused when a beam has no way out and back that shows the tool."""
    frames(scene.beams, scene.R, scene.tool)
    hits: dict[tuple[str, bool], Array] = {}
    used: dict[str, tuple[int, int]] = {}
    for current in (False, True):
        for beam in BEAMS:
            pair = _first_pair(scene, seen, beam, current)
            hits[beam, current] = np.mean([np.mean(seen.crossings[k].at, axis=0) for k in pair], axis=0)
            used[f"{'current' if current else 'reference'} {beam}"] = pair
    a, b = (hits[beam, True] - hits[beam, False] for beam in BEAMS)
    offset = np.array([b[0], a[1], 0.5 * (a[2] + b[2])])
    return Classic(offset, -scene.R.T @ offset, used)


def _first_pair(scene: ToolFrameScene, seen: PassContents, beam: str, current: bool) -> tuple[int, int]:
    own = [k for k, p in enumerate(scene.passes) if p.beam == beam and p.current == current]
    own.sort(key=lambda k: float(scene.passes[k].pose_t[0]))
    for out, back in pairwise(own):
        ways = scene.passes[out].direction, scene.passes[back].direction
        if ways == (1, -1) and out in seen.crossings and back in seen.crossings:
            return out, back
    words = "current" if current else "reference"
    raise Refused(
        "too-few-passes",
        f"no {words} way out and back shows the tool in beam {beam}; the classic method needs both",
    )
