"""Edges as bounds on what is unknown.

For edge ``k`` of a beam, seen at ``y`` along ``n`` with the reference's tool point, ``h`` along ``w``::

    e_k = cos b (y - v tau - sgn(v) hysteresis/2 +- v lag/2 + s) + sin b (h + z)

``b`` is the tilt that the beam sees, ``s`` and ``z`` the displacement of the tool's point along ``n`` and
``w`` (none for the reference), ``tau`` the delay, ``hysteresis`` a shift along the way that does not depend
on the speed, ``lag`` how much later the input clears than it breaks. The places ``e_k`` are the same for the
reference and for the current tool, both ways and all heights, so nothing is assumed about radius or symmetry;
but for heights near the tool's end, where each finger is ``2 c`` narrower, evenly: ``e_k +- c``, with a ``c``
of its own at each such height.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from calibration.tool_frame.crossings import Crossing
from cell.poses import Array

SPEEDS_DIFFER = 1.2
_PRIOR = {"tau": 0.1, "lag": 0.1, "hysteresis": 2e-3, "shift": 0.1, "tilt": 0.5, "narrower": 1e-3}
# A pin in a holder and the finger of a gripper stand to a few milliradians as their drawings say: ISO 2768-1,
# class m, allows 5.8 mrad over 50 to 120 mm.
_TRUST_AXIS_RAD = 2e-3
# Where heights are so close that no tilt is reported.
_TRUST_UNSEEN_AXIS_RAD, _TRUST_STRAIGHT_RAD = 1e-4, 2e-4


@dataclass(frozen=True)
class LateralModel:
    """Which unknowns there are, in their order.

    ``shifts`` are the groups of passes that are displaced against the reference's (named as their beam for
    the current set). ``tilts`` and ``own_tilts`` name the beams at which the current tool, and the reference,
    were seen at different heights, ``hints`` those of ``tilts`` whose heights are close together. ``delays``
    is 1, or 2 when the reference and the current set have one each, ``lag`` whether the tool was crossed at
    several speeds where it is as wide as it gets, and ``near_ends`` are the heights of other crossings.
    ``free`` names unknowns that are clearly not zero, where zero would be expected.
    """

    shifts: tuple[str, ...]
    tilts: tuple[str, ...] = ()
    own_tilts: tuple[str, ...] = ()
    delays: int = 1
    several_speeds: bool = False
    lag: bool = False
    near_ends: tuple[str, ...] = ()
    hints: tuple[str, ...] = ()
    free: tuple[str, ...] = ()

    @property
    def names(self) -> list[str]:
        found = ["tau"] if self.delays == 1 else ["tau", "tau_current"]
        if self.several_speeds:
            found += ["hysteresis"]
        if self.lag:
            found += ["lag"]
        found += [f"shift {name}" for name in self.shifts]
        found += [f"tilt {name}" for name in self.tilts]
        found += [f"own tilt {name}" for name in self.own_tilts]
        return found + [f"narrower {name}" for name in self.near_ends]

    def column(self, name: str) -> int | None:
        names = self.names
        return names.index(name) if name in names else None

    @property
    def prior_sd(self) -> Array:
        """(d,) so wide that it only keeps what nothing measures from running away."""
        kinds = [name.replace("own ", "").split()[0].split("_")[0] for name in self.names]
        return np.array([_PRIOR[kind] for kind in kinds])

    @property
    def trust(self) -> Array:
        """(d,) scale of a Cauchy prior about zero: a reference's axis is about what it is said to be, and
        where the data clearly show another one they are believed. inf where there is none."""
        hints = {f"tilt {beam}": _TRUST_STRAIGHT_RAD for beam in self.hints}
        own = {
            f"own tilt {beam}": _TRUST_UNSEEN_AXIS_RAD if beam in self.hints else _TRUST_AXIS_RAD
            for beam in self.own_tilts
        }
        known = {name: scale for name, scale in {**hints, **own}.items() if name not in self.free}
        return np.array([known.get(name, np.inf) for name in self.names])


@dataclass(frozen=True, eq=False)
class Rows:
    """``e[edge] + X psi`` lies in ``low .. high`` (n,) m, whose ends are off by about ``soft`` (n,) m.

    ``source`` (n,) is the place of the pass in the scene, ``middle`` the middle of the bounds.
    """

    low: Array
    high: Array
    soft: Array
    edge: NDArray[np.int64]
    X: Array
    source: NDArray[np.int64]
    labels: Sequence[tuple[str, int]] = field(default_factory=tuple)

    @property
    def middle(self) -> Array:
        found: Array = 0.5 * (self.low + self.high)
        return found

    @property
    def width(self) -> Array:
        found: Array = self.high - self.low
        return found

    def take(self, keep: NDArray[np.bool_]) -> "Rows":
        return Rows(
            self.low[keep],
            self.high[keep],
            self.soft[keep],
            self.edge[keep],
            self.X[keep],
            self.source[keep],
            self.labels,
        )


@dataclass(frozen=True)
class At:
    """Where the equations are linearised: tilts (rad) and displacements (m), by group; absent is zero."""

    tilt: Mapping[str, float] = field(default_factory=dict)
    own_tilt: Mapping[str, float] = field(default_factory=dict)
    shift: Mapping[str, float] = field(default_factory=dict)
    along_w: Mapping[str, float] = field(default_factory=dict)


def with_speeds(model: LateralModel, crossings: Mapping[int, Crossing]) -> LateralModel:
    """``model`` with the unknowns that the speeds of the passes, and those near the tool's end, call for."""
    whole = [c.speed for c in crossings.values() if not c.near_end]
    near = sorted({c.near_end for c in crossings.values()} - {""})
    return replace(
        model,
        several_speeds=_differ([c.speed for c in crossings.values()]),
        lag=_differ(whole),
        near_ends=tuple(near),
    )


def _differ(speeds: Sequence[float]) -> bool:
    return bool(speeds) and max(speeds) > SPEEDS_DIFFER * min(speeds)


def rows_of(
    crossings: Mapping[int, Crossing],
    groups: Mapping[int, str],
    model: LateralModel,
    at: At,
    height: Mapping[str, float],
) -> Rows:
    """The bounds of all ``crossings``. ``groups`` names the group of each; one that is not in
    ``model.shifts`` is where displacement is counted from. ``height`` is added to ``h`` of each beam."""
    column = {name: k for k, name in enumerate(model.names)}
    labels = sorted({(c.source.beam, j) for c in crossings.values() for j in range(c.edges)})
    number = {label: k for k, label in enumerate(labels)}
    kinds = {
        (c.source.beam, c.source.current, groups[place]): None for place, c in crossings.items()
    }  # few: all else is the same for the crossings of one
    own = [list(kinds).index((c.source.beam, c.source.current, groups[k])) for k, c in crossings.items()]
    count = [c.edges for c in crossings.values()]
    of = np.repeat(own, count)
    tilt, cos, sin, up, s, z = np.array([_kind(model, at, height, *kind) for kind in kinds]).T[:, of]
    low, high, soft, above, v = (
        np.concatenate([getattr(c, name) for c in crossings.values()])
        for name in ("low", "high", "soft", "above", "v")
    )
    rising = np.concatenate([c.rising for c in crossings.values()])
    h = above + up + z
    slope = cos * h - sin * (0.5 * (low + high) + s)
    X, base = np.zeros((len(low), len(column))), np.zeros(len(low))
    if model.several_speeds:
        X[:, column["hysteresis"]] = 0.5 * cos * np.sign(v)
    if model.lag:
        X[:, column["lag"]] = 0.5 * cos * v * np.where(rising, -1.0, 1.0)
    for k, (beam, current, group) in enumerate(kinds):
        rows = of == k
        X[rows, column["tau_current" if model.delays == 2 and current else "tau"]] = (cos * v)[rows]
        if group in model.shifts:
            X[rows, column[f"shift {group}"]] = -cos[rows]
        name = f"tilt {beam}" if current else f"own tilt {beam}"
        if name in column:
            X[rows, column[name]] = -slope[rows]
            base[rows] = (-slope * tilt)[rows]
    first = np.cumsum(count) - count
    for begin, c in zip(first.tolist(), crossings.values(), strict=True):
        if f"narrower {c.near_end}" in column:
            X[begin : begin + c.edges, column[f"narrower {c.near_end}"]] = c.inwards
    offset = sin * h + base
    return Rows(
        cos * low + offset,
        cos * high + offset,
        cos * soft / np.sqrt(3.0),
        np.array([number[c.source.beam, j] for c in crossings.values() for j in range(c.edges)], np.int64),
        X,
        np.repeat(np.array(list(crossings), np.int64), count),
        labels,
    )


def _kind(
    model: LateralModel, at: At, height: Mapping[str, float], beam: str, current: bool, group: str
) -> tuple[float, ...]:
    """Of the passes of one beam, set and group: the tilt, its cosine and sine, what is added to heights above
    the beam, and the displacement along ``n`` and ``w``."""
    tilt = at.tilt.get(beam, 0.0) if current else at.own_tilt.get(beam, 0.0)
    s, z = (at.shift.get(group, 0.0), at.along_w.get(group, 0.0)) if group in model.shifts else (0.0, 0.0)
    return tilt, np.cos(tilt), np.sin(tilt), height.get(beam, 0.0), s, z
