"""At which heights the tool of a reference first met each beam, at each place along it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calibration.tool_frame import geometry as geo
from calibration.tool_frame.contacts import Looks
from calibration.tool_frame.crossings import PassContents
from calibration.tool_frame.geometry import BeamFrame
from calibration.tool_frame.height import mixed
from calibration.tool_frame.hits import HeightBracket, bracket
from calibration.tool_frame.places import CrossingPlaces
from calibration.tool_frame.repeatability import PassScatter
from calibration.tool_frame.scene import Refused, ToolFrameScene
from calibration.tool_frame.tip import ENDS, POINT, ToolInBeam
from cell.poses import Array

Spot = tuple[str, int]


@dataclass(frozen=True, eq=False)
class SpotHeights:
    """``mean`` (k,) m of the beam over the line given for it at each of ``spots``, and ``cov`` (k, k)."""

    spots: Sequence[Spot]
    mean: Array
    cov: Array

    def at(self, spot: Spot) -> tuple[float, float]:
        """Height and its standard deviation, m."""
        k = self.spots.index(spot)
        return float(self.mean[k]), float(np.sqrt(self.cov[k, k]))

    def cov_of(self, spots: Sequence[Spot]) -> Array:
        """(n, n) m^2 of some of them."""
        k = [self.spots.index(spot) for spot in spots]
        found: Array = self.cov[np.ix_(k, k)]
        return found


class _Spots:
    def __init__(
        self,
        scene: ToolFrameScene,
        frames: Mapping[str, BeamFrame],
        seen: PassContents,
        places: CrossingPlaces,
    ) -> None:
        self.scene, self.frames, self.seen, self.places = scene, frames, seen, places

    def own(self, spot: Spot) -> list[int]:
        return [k for k, p in enumerate(self.scene.passes) if (p.beam, self.places.of[k]) == spot]

    def bracket(self, spot: Spot) -> HeightBracket:
        """Flange heights along the beam's ``w``."""
        own, w = self.own(spot), self.frames[spot[0]].w
        height = {k: float(self.scene.passes[k].middle @ w) for k in own}
        hits = {k: height[k] for k in own if k in self.seen.crossings or k in self.seen.partial}
        found = bracket(hits, {k: height[k] for k in own if k in self.seen.missed})
        if found is None:
            beam, j = spot
            raise Refused(
                "no-height",
                f"no pass goes by above the tool's point at place {j + 1} of beam {beam}; it has no height",
            )
        return found

    def over_line(self, beam: str, flange: float) -> float:
        """How far (m) the tool's point is over the line of a beam with the flange at this height."""
        w, line = self.frames[beam].w, self.frames[beam].line
        return flange + float(w @ (self.scene.R @ self.scene.tool.p - line.point))


def rough_heights(
    scene: ToolFrameScene,
    frames: Mapping[str, BeamFrame],
    seen: PassContents,
    places: CrossingPlaces,
    spots: Sequence[Spot],
) -> SpotHeights:
    """From the middles of what hits and misses leave open."""
    found = _Spots(scene, frames, seen, places)
    brackets = [found.bracket(spot) for spot in spots]
    mean = [found.over_line(beam, b.middle) for (beam, _), b in zip(spots, brackets, strict=True)]
    return SpotHeights(spots, np.array(mean), np.diag([b.width**2 / 12.0 + 1e-12 for b in brackets]))


def spot_heights(
    scene: ToolFrameScene,
    frames: Mapping[str, BeamFrame],
    seen: PassContents,
    places: CrossingPlaces,
    spots: Sequence[Spot],
    own_tilt: Mapping[str, float],
    edges: Mapping[str, Array],
    scatter: PassScatter,
    tau: float,
) -> SpotHeights:
    """From all passes near the tool's end. ``own_tilt`` (rad) by beam is that of the tool, ``edges`` (k,) m
    the places of its edges, ``tau`` (s) the delay that ``seen`` was read with."""
    found = _Spots(scene, frames, seen, places)
    axis = geo.turned_axis(frames, scene.R @ scene.tool.axis, own_tilt)
    ends = POINT if any(len(e) > 2 for e in edges.values()) else ENDS
    densities = []
    for spot in spots:
        beam = spot[0]
        frame, e = frames[beam], edges[beam]
        chord = float(e[1] - e[0])
        view = ToolInBeam.of(
            axis, frame.normal(own_tilt[beam]), frame.line.direction, frame.w, 0.5 * chord, chord
        )
        looks = Looks(scene, seen, frame, frame.w, tau)
        densities.append(looks.density(found.own(spot), found.bracket(spot), view, ends, scatter))
    mean, cov, _ = mixed(densities, ends, scatter)
    over = [found.over_line(beam, float(m)) for (beam, _), m in zip(spots, mean, strict=True)]
    return SpotHeights(spots, np.array(over), cov)
