"""Shapes that the end of a tool may have: how long it breaks a beam, and how much lower it reaches tilted.

At a depth ``d`` below the first contact a ball is ``2 sqrt(2 r d)`` wide, a flat end that is tilted begins
with a corner, and a level one is as wide as the tool at once. An input with hysteresis clears only at a
greater distance than it breaks, as if the tool were deeper by then: a break is longer by that at the side
that leaves the beam last, which for a tilted flat end is much in one direction of the way and little in the
other. A beam has a radius, and the rim of a flat end a chamfer: it is as wide as the tool only so far up.
Which shape it is, the passes near the end tell; of one that is none of these, whether a pass met it at all.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from cell.poses import Array

_TURN = np.linspace(0.0, 2.0 * np.pi, 181)[:, None]
_ALONG = np.linspace(-1.0, 1.0, 61)[:, None]
_RATIOS = {0.15: 0.1, 0.4: 0.1, 0.7: 0.1, 1.0: 0.6, 1.5: 0.1}
_BANDS_M = (0.0, 1.5e-5, 3e-5, 5e-5, 8e-5, 1.2e-4)
_RIMS_M = (1e-4, 2e-4, 3e-4, 4e-4, 5e-4, 6e-4, 8e-4)
_RIM_BANDS_M = (0.0, 3e-5, 6e-5, 1.2e-4)
_ROUND = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 25)
_LEVEL_M = 1e-12  # what rounding makes of one height
_FINE_BANDS_M = (0.0, 1e-5, 2e-5, 3e-5, 4e-5, 5e-5, 6e-5, 8e-5, 1e-4, 1.2e-4)


@dataclass(frozen=True)
class TipShape:
    """One shape. ``prior`` is how likely it is before any pass. ``ratio`` is a ball's radius as a share of
    the tool's, ``band`` (m) by how much more distance the beam clears than it breaks, ``rim`` (m) the radius
    of a flat end's rim and of the beam together. Of the kind "other" no length of
    a break is known; a pass may miss it as deep down as it may miss that ball."""

    kind: str
    prior: float
    ratio: float = 1.0
    band: float = 0.0
    rim: float = 0.0


def _with_bands(
    kind: str, prior: float, bands: Sequence[float], ratio: float = 1.0, rim: float = 0.0
) -> list[TipShape]:
    return [TipShape(kind, prior / len(bands), ratio, band, rim) for band in bands]


ENDS = (
    TipShape("point", 0.1),
    TipShape("other", 0.05, 0.15),
    *_with_bands("edge", 0.1, _FINE_BANDS_M),
    *_with_bands("flat", 0.15, _FINE_BANDS_M),
    *(end for rim in _RIMS_M for end in _with_bands("flat", 0.2 / len(_RIMS_M), _RIM_BANDS_M, rim=rim)),
    *(end for ratio, share in _RATIOS.items() for end in _with_bands("ball", 0.4 * share, _BANDS_M, ratio)),
)
# Of an upright tool, and enough to decide where to cross next.
UPRIGHT = (
    TipShape("point", 0.4),
    TipShape("other", 0.1, 0.15),
    *(end for rim in (2e-4, 4e-4, 6e-4) for end in _with_bands("flat", 0.1 / 3.0, (0.0, 4e-5), rim=rim)),
    *(end for ratio in (0.15, 0.4, 1.0) for end in _with_bands("ball", 0.4 / 3.0, (0.0, 4e-5), ratio)),
)
POINT = (TipShape("point", 1.0),)  # where widths tell nothing


@dataclass(frozen=True, eq=False)
class ToolInBeam:
    """The tool as one beam sees it in one set.

    ``axis`` (3,) is in the base from the flange to the point, ``n`` (3,) normal to beam and axis, ``lift``
    and ``side`` (3,) are up and along the pass, both normal to the beam. ``radius`` (m) is the tool's,
    ``chord`` (m) how far the flange moves while the tool breaks the beam well above its end.
    """

    axis: Array
    n: Array
    lift: Array
    side: Array
    radius: float
    chord: float

    @classmethod
    def of(cls, axis: Array, n: Array, beam: Array, lift: Array, radius: float, chord: float) -> "ToolInBeam":
        """``beam`` (3,) is the beam's direction."""
        side = np.cross(beam, lift)
        return cls(axis, n, lift, side / np.linalg.norm(side), radius, chord)

    def bulge(self, end: TipShape) -> float:
        """How much lower (m, along ``lift``) the end reaches than its middle, against the tool upright."""
        if end.kind == "edge":
            return self.radius * abs(float(self.lift @ self.n))
        if end.kind == "flat":
            own = max(end.rim - max(0.5 * self.chord - self.radius, 0.0), 0.0)  # of the rim, without the beam
            return max(self.radius - own, 0.0) * self._tilt
        if end.kind == "other":
            return 0.5 * self.radius * self._tilt  # none as of a ball, or as much as of a flat end
        return 0.0

    @property
    def _tilt(self) -> float:
        return float(np.sqrt(max(1.0 - float(self.lift @ self.axis) ** 2, 0.0)))

    def lengths(self, ends: Sequence[TipShape], depth: Array, sense: float = 1.0) -> Array:
        """(E, ...) how long (m) each end breaks the beam at ``depth`` (...) m below the first contact; 0
        above it. ``sense`` is 1 on ways along ``side`` and -1 on those against it."""
        d = np.maximum(depth, 0.0)
        found = np.full((len(ends), *d.shape), self.chord)
        balls: dict[float, tuple[Array, Array, Array]] = {}  # the parts that do not depend on the band
        begins: dict[tuple[str, float], Array] = {}
        for k, end in enumerate(ends):
            if end.kind in ("ball", "other"):
                wide = end.ratio * self.chord
                if wide not in balls:
                    deep = np.minimum(d, 0.5 * wide)
                    rest = wide - deep
                    balls[wide] = deep, rest, np.sqrt(deep * rest)
                deep, rest, begin = balls[wide]
                np.add(begin, np.sqrt((deep + end.band) * rest), out=found[k])
            elif end.kind in ("edge", "flat"):
                up, low, high = self._edge if end.kind == "edge" else self._flat(end.rim)
                first, last = (high, low) if sense > 0.0 else (low, high)
                shape = end.kind, end.rim
                if shape not in begins:
                    begins[shape] = np.interp(d, up, first)
                np.abs(begins[shape] - np.interp(d + end.band, up, last), out=found[k])
        np.minimum(found, self.chord, out=found)
        return np.where(depth > 0.0, found, 0.0)

    @cached_property
    def _edge(self) -> tuple[Array, Array, Array]:
        return self._profile(0.5 * self.chord * _ALONG * self.n)

    @cached_property
    def _flats(self) -> dict[float, tuple[Array, Array, Array]]:
        return {}

    def _flat(self, rim_m: float) -> tuple[Array, Array, Array]:
        if rim_m not in self._flats:
            inner = max(0.5 * self.chord - rim_m, 0.0)
            rim = inner * (np.cos(_TURN) * self.n + np.sin(_TURN) * np.cross(self.axis, self.n))
            if rim_m > 0.0:
                about = rim_m * (np.outer(np.sin(_ROUND), self.side) - np.outer(np.cos(_ROUND), self.lift))
                rim = (rim[:, None] + about).reshape(-1, 3)
            self._flats[rim_m] = self._profile(rim)
        return self._flats[rim_m]

    def _profile(self, rim: Array) -> tuple[Array, Array, Array]:
        """Heights (n,) m over the lowest place of ``rim`` (n, 3) m, and between which places (n,) along
        ``side`` the end is."""
        up, along = rim @ self.lift, rim @ self.side
        order = np.argsort(up)
        up, along = up[order] - np.min(up), along[order]
        # Of places as high as each other all count at once: their order is chance.
        last = np.append(np.diff(up) > _LEVEL_M, True)
        return up[last], np.minimum.accumulate(along)[last], np.maximum.accumulate(along)[last]
