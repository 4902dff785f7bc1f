"""The first contacts of a tool with both beams: what all passes near its end say of the height."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calibration.tool_frame.crossings import Crossing, PassContents
from calibration.tool_frame.geometry import BeamFrame
from calibration.tool_frame.glimpse import Glimpse, glimpse, plain_hit
from calibration.tool_frame.height import Density, first_contact
from calibration.tool_frame.hits import HeightBracket
from calibration.tool_frame.repeatability import PassScatter
from calibration.tool_frame.scene import Pass, ToolFrameScene
from calibration.tool_frame.tip import TipShape, ToolInBeam
from cell.poses import Array

_SAME_HEIGHT_M = 5e-6
_CENTRE_M = 1.5e-4  # a tool that switches late, or is tilted, is not exactly in the middle of its crossings


@dataclass(frozen=True, eq=False)
class Looks:
    """Passes of one beam and set at ``places`` in the scene, as ``frame`` sees them; ``tau`` (s) is the delay
    that the crossings were read with, ``lift`` (3,) up."""

    scene: ToolFrameScene
    seen: PassContents
    frame: BeamFrame
    lift: Array
    tau: float

    def density(
        self,
        places: Sequence[int],
        bracket: HeightBracket,
        view: ToolInBeam,
        ends: Sequence[TipShape],
        scatter: PassScatter,
    ) -> Density:
        """Where the end of the tool first meets the beam, m along the lift."""
        return first_contact(self.glimpses(places), view, ends, scatter, bracket.hit, bracket.miss)

    def glimpses(self, places: Sequence[int]) -> list[Glimpse]:
        """What each pass says; those whose beam is broken at an end of the way say nothing."""
        order = sorted(places, key=lambda k: float(self.scene.passes[k].pose_t[0]))
        crossings = [self.seen.crossings[k] for k in order if k in self.seen.crossings]
        whole = [c for c in crossings if c.edges == 2]
        centre, sigma = _centre(whole or crossings)
        found: list[Glimpse] = []
        pair, before = 0, None
        for k in order:
            p = self.scene.passes[k]
            height = float(p.middle @ self.lift)
            back = before is not None and before[0] == 1 and p.direction == -1
            if not (back and before is not None and abs(height - before[1]) < _SAME_HEIGHT_M):
                pair += 1
            before = (p.direction, height)
            c = self.seen.crossings.get(k)
            if k in self.seen.missed or (c is not None and c.edges == 2):
                found.append(self._one(p, height, pair, c, centre, sigma))
            elif c is not None or k in self.seen.partial:
                found.append(plain_hit(height, pair))
        return found

    def _one(
        self, p: Pass, height: float, pair: int, c: Crossing | None, centre: float, sigma: float
    ) -> Glimpse:
        y = self.frame.across(p.pose_xyz + self.scene.R @ self.scene.tool.p)
        sense = 1.0 if y[-1] >= y[0] else -1.0
        places = np.maximum.accumulate(sense * np.interp(p.poll_t - self.tau, p.pose_t, y))
        soft, pulse = 0.0, None
        if c is not None:
            soft = float(np.mean(c.soft))
            ends = sorted((sense * float(c.low[0]), sense * float(c.high[0])))
            pulse = (ends[0], ends[1])
        along = sense * float(np.sign(np.cross(self.frame.line.direction, self.lift) @ self.frame.n))
        return glimpse(height, pair, places, p.poll_v, sense * centre, sigma, soft, pulse, along)


def _centre(crossings: Sequence[Crossing]) -> tuple[float, float]:
    """Where the middle of a break is expected, m along ``n``, and its standard deviation."""
    if not crossings:
        return 0.0, 1.0
    middles = np.array([0.5 * float(c.middle[0] + c.middle[-1]) for c in crossings])
    fingers = float(np.median([c.chord for c in crossings])) if crossings[0].edges > 2 else 0.0
    return float(np.median(middles)), float(np.hypot(_CENTRE_M, np.std(middles))) + 0.5 * fingers


def stated(height: float, sigma: float, shape: tuple[int, int]) -> Density:
    """A first contact that is known from elsewhere."""
    grid = np.array([height])
    flat = np.zeros(shape)
    return Density(grid, flat[..., None], flat, flat + height, flat + sigma**2)
