"""Half-chord centres of passes, and how far those out and back are apart."""

from collections.abc import Mapping
from itertools import pairwise

import numpy as np

from calibration.tool_frame.crossings import Crossing
from calibration.tool_frame.scene import ToolFrameScene


def centre(c: Crossing, value: Mapping[str, float]) -> float:
    """Half-chord centre of one pass along ``n``, m, without delay and hysteresis (``value``, by name)."""
    v = float(np.mean(c.v))
    late = v * value["tau"] + 0.5 * float(np.sign(v)) * (value.get("hysteresis") or 0.0)
    return 0.5 * float(c.middle[0] + c.middle[-1]) - late


def out_back(
    scene: ToolFrameScene, crossings: Mapping[int, Crossing], value: Mapping[str, float]
) -> dict[tuple[int, int], float]:
    """Half-chord centre out minus back, m, of each pair that follows on another, with the delay removed."""
    found = {}
    order = sorted(crossings, key=lambda k: (scene.passes[k].beam, float(scene.passes[k].pose_t[0])))
    for a, b in pairwise(order):
        p, q = scene.passes[a], scene.passes[b]
        if p.beam == q.beam and p.direction == 1 and q.direction == -1:
            found[a, b] = centre(crossings[a], value) - centre(crossings[b], value)
    return found
