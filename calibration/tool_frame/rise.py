"""How far the tool's point moved along its axis: from where its end first met each beam, then and now.

The end of the reference meets a beam with the flange at the height ``c``, that of the current tool at
``c' = c - w.dp - bulge``, ``bulge`` being how much lower a tilted end reaches than its middle. Which end it
is and how well the arm repeats are the same for all four heights; what they leave open is in the answer.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from calibration.tool_frame import geometry as geo
from calibration.tool_frame.bounds import At
from calibration.tool_frame.contacts import Looks, stated
from calibration.tool_frame.geometry import BEAMS
from calibration.tool_frame.height import Density, weights
from calibration.tool_frame.lateral import Lateral
from calibration.tool_frame.repeatability import PassScatter, scatter_of
from calibration.tool_frame.tip import ENDS, POINT, TipShape, ToolInBeam
from calibration.tool_frame.vertical import Vertical
from cell.poses import Array

_LATE_CLEARING_M = 5e-4
_STATED_M = 2e-5
_AGREE_M = 2e-6  # two beams cannot agree better than the frames of the model

Heights = dict[tuple[str, bool], tuple[float, float]]


@dataclass(frozen=True, eq=False)
class Along:
    """Displacement along the axis towards the flange: ``z`` (m) and its variance ``own`` (m^2) with the
    unknowns across held; ``current`` is the part of ``own`` that the current passes have, ``slope`` (d,) how
    it goes with these unknowns, and ``bend`` (m^2) what their uncertainty adds beyond that slope."""

    z: float
    own: float
    current: float
    slope: Array
    bend: float


class Rise:
    """The four first contacts of one comparison, and what follows from them."""

    def __init__(self, vertical: Vertical, lateral: Lateral, at: At, stated_m: float | None) -> None:
        self.vertical, self.lateral, self.at = vertical, lateral, at
        self.edges = {b: lateral.edges(b) for b in BEAMS}
        self.fingers = any(len(e) > 2 for e in self.edges.values())
        self.ends: tuple[TipShape, ...] = POINT if self.fingers else ENDS
        self.scatter: PassScatter = scatter_of(stated_m, lateral.noise.of_way, lateral.noise.spread)
        radius = {b: 0.5 * float(e[-1] - e[0]) for b, e in self.edges.items()}
        # A beam that clears later than it breaks makes all widths larger alike.
        wider = {b: r - vertical.scene.tool.radius for b, r in radius.items()}
        self.radius = {
            b: r - (wider[b] if abs(wider[b]) <= _LATE_CLEARING_M else 0.0) for b, r in radius.items()
        }
        self.densities = {key: self._density(*key) for key in vertical.brackets}
        self.beams = [b for b in BEAMS if all((b, now) in self.densities for now in (False, True))]
        self.told = bool(self.beams)
        self.weight = self._weight() if self.told else self._own_weight(np.zeros(()))

    @property
    def heights(self) -> Heights:
        """Flange height (m) of each first contact by beam and set, with its standard deviation."""
        found = {}
        for key, d in self.densities.items():
            w = self.weight if self.told else self._own_weight(d.evidence)
            mean = float(np.sum(w * d.mean))
            found[key] = mean, float(np.sqrt(np.sum(w * (d.var + (d.mean - mean) ** 2))))
        return found

    @property
    def scatter_m(self) -> float | None:
        """What single passes scatter by along the tool, m."""
        return float(np.sum(self.weight, axis=0) @ self.scatter.sigmas) if self.told else None

    @property
    def shapes(self) -> dict[str, float]:
        """How likely each kind of end is."""
        found: dict[str, float] = {}
        if self.told:
            for end, w in zip(self.ends, np.sum(self.weight, axis=1), strict=True):
                found[end.kind] = found.get(end.kind, 0.0) + float(w)
        return found

    def along(self) -> Along | None:
        """None where nothing tells the height."""
        if not self.told:
            return None
        d = len(self.lateral.model.names)
        mean, cov = self.lateral.linear[:d], self.lateral.cov[:d, :d]
        here, var = self._mixture(self.at)
        z = float(np.sum(self.weight * here))
        own = float(np.sum(self.weight * (var + (here - z) ** 2)))
        scale = np.sqrt(np.diag(cov))
        root = scale[:, None] * np.linalg.cholesky(cov / np.outer(scale, scale) + 1e-9 * np.eye(d))
        ends = np.array([[self._mean(self._moved(mean + s * step)) for s in (1.0, -1.0)] for step in root.T])
        slope = np.linalg.solve(root.T, 0.5 * (ends[:, 0] - ends[:, 1]))
        second = 0.5 * np.sum(ends, axis=1) - z
        bend = 0.5 * float(second @ second)
        return Along(z + float(np.sum(second)), own, own * self._share(), slope, bend)

    def _share(self) -> float:
        """Which part of the variance the current passes have, the rest being the reference's."""
        then, now = (
            sum(float(np.sum(self.weight * self.densities[b, current].var)) for b in self.beams)
            for current in (False, True)
        )
        return now / (then + now)

    def _mean(self, at: At) -> float:
        return float(np.sum(self.weight * self._mixture(at)[0]))

    def _moved(self, psi: Array) -> At:
        """``at`` with other unknowns."""
        value = dict(zip(self.lateral.model.names, psi, strict=True))
        at = self.at
        return At(
            {b: float(value.get(f"tilt {b}", t)) for b, t in at.tilt.items()},
            {b: float(value.get(f"own tilt {b}", t)) for b, t in at.own_tilt.items()},
            {g: float(value.get(f"shift {g}", s)) for g, s in at.shift.items()},
            at.along_w,
        )

    def _weight(self) -> Array:
        """(E, S): also by how well both beams agree."""
        evidence = sum(
            (self.densities[b, now].evidence for b in self.beams for now in (False, True)), np.zeros(())
        )
        z, var, _ = self._each(self.at)
        if len(z) == 2:
            spread = var[0] + var[1] + _AGREE_M**2
            evidence = evidence - 0.5 * ((z[0] - z[1]) ** 2 / spread + np.log(spread))
        return self._own_weight(evidence)

    def _own_weight(self, evidence: Array) -> Array:
        return weights(evidence, self.ends, self.scatter)

    def _each(self, at: At) -> tuple[Array, Array, Array]:
        """(B, E, S) displacement by each beam, and its variance; and (B, E) m, what both lack alike."""
        vertical = self.vertical
        sideways = vertical.displacement(at, 0.0)
        found, variances, alike = [], [], []
        for beam in self.beams:
            lift = vertical.lifts[beam]
            slope = float(-vertical.axis @ lift)
            then, now = self.densities[beam, False], self.densities[beam, True]
            bulge, sigma = self._bulge(beam, at)
            lower = then.mean - now.mean - float(lift @ sideways) + bulge[:, None]
            found.append(lower / slope)
            variances.append((then.var + now.var) / slope**2)
            alike.append(sigma / abs(slope))
        return np.stack(found), np.stack(variances), np.stack(alike)

    def _mixture(self, at: At) -> tuple[Array, Array]:
        """(E, S) displacement by both beams together, and its variance."""
        z, var, alike = self._each(at)
        total = 1.0 / np.sum(1.0 / var, axis=0)
        return total * np.sum(z / var, axis=0), total + np.mean(alike, axis=0)[:, None] ** 2

    def _bulge(self, beam: str, at: At) -> tuple[Array, Array]:
        """(E,) how much lower each end reaches now than in the reference, m, and (E,) what is not known of
        it."""
        if self.fingers:
            # Of several fingers it is not known where along the beam each of them is.
            most = sum(self.radius[b] * abs(at.tilt.get(b, 0.0) - at.own_tilt.get(b, 0.0)) for b in BEAMS)
            return np.array([0.5 * most]), np.array([most / float(np.sqrt(12.0))])
        then, now = self._view(beam, False, at), self._view(beam, True, at)
        lower = np.array([now.bulge(end) - then.bulge(end) for end in self.ends])
        # Of an end without a shape anything from nothing to twice as much.
        other = np.array([end.kind == "other" for end in self.ends])
        return lower, np.where(other, np.abs(lower) / float(np.sqrt(3.0)), 0.0)

    def _density(self, beam: str, current: bool) -> Density:
        v = self.vertical
        bracket = v.brackets[beam, current]
        if bracket.assumed and bracket.width == 0.0:
            return stated(bracket.middle, _STATED_M, (len(self.ends), len(self.scatter.sigmas)))
        looks = Looks(v.scene, v.seen, v.frames[beam], v.lifts[beam], self.lateral.tau_read)
        own = [k for k, p in enumerate(v.scene.passes) if p.beam == beam and p.current == current]
        view = self._view(beam, current, self.at)
        return looks.density(own, bracket, view, self.ends, self.scatter)

    def _view(self, beam: str, current: bool, at: At) -> ToolInBeam:
        v = self.vertical
        turns: Mapping[str, float] = at.tilt if current else at.own_tilt
        turned = {b: turns.get(b, 0.0) for b in BEAMS}
        edges = self.edges[beam]
        chord = float(edges[1] - edges[0] if self.fingers else edges[-1] - edges[0])
        axis = geo.turned_axis(v.frames, v.axis, turned)
        normal = v.frames[beam].normal(turned[beam])
        return ToolInBeam.of(
            axis, normal, v.frames[beam].line.direction, v.lifts[beam], self.radius[beam], chord
        )
