"""The ways near the tool's end: what each showed, and where the solution has the first contact."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from calibration.tool_frame.geometry import BEAMS, frames
from calibration.tool_frame.places import at_current_places
from calibration.tool_frame.scene import ToolFrameScene
from calibration.tool_frame.vertical import Vertical
from cell.poses import Array
from procedures.laser.report.passes import Rejected, ShownPasses, shown
from procedures.laser.result import LaserResult

_NEAR_M = 6e-4  # on either side of the first contacts: ways farther off tell little

Key = tuple[str, bool]  # beam, and whether of the current set


@dataclass(frozen=True, eq=False)
class NearEnd:
    """Heights are those of the reference's point over the beam, m.

    ``heights`` (n,) are those of the passes of ``found``, ``contacts`` the first contacts that the solution
    found, with their standard deviations. ``spans`` is, by beam, what is near the end.
    """

    found: ShownPasses
    heights: Array
    contacts: Mapping[Key, tuple[float, float]]
    spans: Mapping[str, tuple[float, float]]

    def ways(self, beam: str, current: bool) -> dict[str, list[int]]:
        """The places of the passes near the end, by what they showed; those that tell nothing are left out.

        One-sided is a way there and back at one height of which one showed the tool and the other did not.
        """
        low, high = self.spans[beam]
        seen, chosen = self.found.seen, self.found.chosen
        told: dict[str, list[int]] = {}
        for k in self.found.of(beam, current):
            missed = k in seen.missed
            if low <= self.heights[k] <= high and (missed or k in seen.crossings or k in seen.partial):
                both = k in (chosen.missed if missed else chosen.hits)
                word = ("miss" if missed else "hit") + ("" if both else ", one-sided")
                told.setdefault(word, []).append(k)
        return told


def near_end(
    scene: ToolFrameScene, tau: float, rejected: Rejected, measured: LaserResult | None
) -> NearEnd | None:
    """As :func:`shown`, of the passes that a comparison has; None without any way near a first contact."""
    found = shown(at_current_places(scene), tau, rejected)
    scene = found.scene
    vertical = Vertical(scene, frames(scene.beams, scene.R, scene.tool), found.seen, found.chosen)
    over = {b: float(vertical.lifts[b] @ (scene.R @ scene.tool.p - scene.beams[b].point)) for b in BEAMS}
    heights = np.array([float(p.middle @ vertical.lifts[p.beam]) + over[p.beam] for p in scene.passes])
    stated = {} if measured is None else measured.observability.heights_m or {}
    names = {f"{name} {b}": (b, name == "current") for b in BEAMS for name in ("reference", "current")}
    contacts = {
        names[name]: (height + over[names[name][0]], sigma) for name, (height, sigma) in stated.items()
    }
    spans = {}
    for b in BEAMS:
        about = [height for (beam, _), (height, _) in contacts.items() if beam == b]
        between = [v for (beam, _), v in vertical.brackets.items() if beam == b]
        about = about or [end + over[b] for v in between for end in (v.hit, v.miss)]
        if about:
            spans[b] = min(about) - _NEAR_M, max(about) + _NEAR_M
    return NearEnd(found, heights, contacts, spans) if spans else None
