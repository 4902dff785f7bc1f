"""Shapes that the end of a tool may have: how long it breaks a beam, and how much lower it reaches tilted.

At a depth ``d`` below the first contact a ball is ``2 sqrt(2 r d)`` wide, a flat end that is tilted begins
with a corner, and a level one is as wide as the tool at once. A beam that clears at a greater distance than
it breaks makes the second half of a ball's chord longer. Which shape it is, the passes near the end tell.
"""

from dataclasses import dataclass

import numpy as np

from cell.poses import Array

_RIM = np.linspace(0.0, 2.0 * np.pi, 181)
_RATIOS = {0.15: 0.1, 0.4: 0.1, 0.7: 0.1, 1.0: 0.6, 1.5: 0.1}
_BANDS_M = (0.0, 1.5e-5, 3e-5, 5e-5, 8e-5, 1.2e-4)


@dataclass(frozen=True)
class End:
    """One shape. ``prior`` is how likely it is before any pass. ``ratio`` is a ball's radius as a share of
    the tool's, ``band`` (m) by how much more distance the beam clears than it breaks."""

    kind: str
    prior: float
    ratio: float = 1.0
    band: float = 0.0


ENDS = (
    End("point", 0.15),
    End("edge", 0.1),
    End("flat", 0.35),
    *(End("ball", 0.4 * w / len(_BANDS_M), ratio, band) for ratio, w in _RATIOS.items() for band in _BANDS_M),
)
POINT = (End("point", 1.0),)  # where widths tell nothing


@dataclass(frozen=True, eq=False)
class View:
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
    def of(cls, axis: Array, n: Array, beam: Array, lift: Array, radius: float, chord: float) -> "View":
        """``beam`` (3,) is the beam's direction."""
        side = np.cross(beam, lift)
        return cls(axis, n, lift, side / np.linalg.norm(side), radius, chord)

    def bulge(self, end: End) -> float:
        """How much lower (m, along ``lift``) the end reaches than its middle, against the tool upright."""
        if end.kind == "edge":
            return self.radius * abs(float(self.lift @ self.n))
        if end.kind == "flat":
            return self.radius * float(np.sqrt(max(1.0 - float(self.lift @ self.axis) ** 2, 0.0)))
        return 0.0

    def length(self, end: End, depth: Array) -> Array:
        """How long (m) the beam is broken at ``depth`` (n,) m below the first contact; 0 above it."""
        d = np.maximum(depth, 0.0)
        found = np.full(d.shape, self.chord)
        if end.kind == "ball":
            wide = end.ratio * self.chord
            d = np.minimum(d, 0.5 * wide)
            found = np.sqrt(d * (wide - d)) + np.sqrt((d + end.band) * (wide - d))
        elif end.kind == "edge" and (lean := abs(float(self.lift @ self.n))) > 1e-6:
            found = d / lean
        elif end.kind == "flat" and (rim := self._rim()) is not None:
            found = np.interp(d, *rim)
        return np.where(depth > 0.0, np.minimum(found, self.chord), 0.0)

    def _rim(self) -> tuple[Array, Array] | None:
        """Depths (n,) m and the widths (n,) m there of a tilted flat end; None when it is level."""
        e1 = np.cross(self.axis, self.lift)
        if float(np.linalg.norm(e1)) < 1e-6:
            return None
        e1 = e1 / np.linalg.norm(e1)
        e2 = np.cross(self.axis, e1)
        rim = 0.5 * self.chord * (np.cos(_RIM)[:, None] * e1 + np.sin(_RIM)[:, None] * e2)
        up, along = rim @ self.lift, rim @ self.side
        order = np.argsort(up)
        low, along = up[order] - np.min(up), along[order]
        return low, np.maximum.accumulate(along) - np.minimum.accumulate(along)
