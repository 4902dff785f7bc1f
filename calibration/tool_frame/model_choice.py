"""Which unknowns the passes of a comparison call for: tilts, delays and switching, as the data show them."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from calibration.tool_frame.averaging import robust
from calibration.tool_frame.bounds import At, LateralModel, rows_of, with_speeds
from calibration.tool_frame.crossings import Crossing
from calibration.tool_frame.geometry import BEAMS

TWO_HEIGHTS_M = 0.012  # less apart than this, a tilt is not reported
SOME_HEIGHT_M = 0.002
# Standard deviations. With one height no tilt is assumed, and said to be: it takes much to say otherwise,
# as edges that fall on the polls alike in all passes look like some.
_CLEARLY = 5.0
_DELAY_S = 3e-4

Crossings = Mapping[int, Crossing]
Heights = Mapping[str, float]


def groups_of(crossings: Crossings) -> dict[int, str]:
    """The group of each crossing: its beam in the current set, the reference otherwise."""
    return {k: c.source.beam if c.source.current else "reference" for k, c in crossings.items()}


def choose_model(
    crossings: Crossings, height: Heights, axis_known: bool = True
) -> tuple[LateralModel, list[tuple[str, str]]]:
    """The model, and warnings; ``height`` (m) is added to the heights above each beam. Without ``axis_known``
    the tilt of the reference is as open as that of the current tool."""
    span = {(b, current): _span(crossings, b, current) for b in BEAMS for current in (False, True)}
    tilts = tuple(b for b in BEAMS if span[b, True] > SOME_HEIGHT_M)
    model = LateralModel(
        BEAMS,
        tilts,
        tuple(b for b in tilts if span[b, False] > SOME_HEIGHT_M),
        hints=tuple(b for b in tilts if min(span[b, False], span[b, True]) <= TWO_HEIGHTS_M),
    )
    model = with_speeds(model, crossings)
    model, warnings = _delays(model, crossings, height)
    if not axis_known:
        own = tuple(f"own tilt {b}" for b in model.own_tilts)
        return replace(model, free=own), warnings
    return _freed(model, crossings, height), warnings


def _span(crossings: Crossings, beam: str, current: bool) -> float:
    """How far the heights of one set's crossings of one beam are apart, m."""
    h = [
        float(np.mean(c.above))
        for c in crossings.values()
        if c.source.beam == beam and c.source.current == current
    ]
    return float(np.ptp(h)) if h else 0.0


def _delays(
    model: LateralModel, crossings: Crossings, height: Heights
) -> tuple[LateralModel, list[tuple[str, str]]]:
    """``model`` with two delays where the input clearly was not as late in the reference as it is now."""
    apart = replace(model, delays=2)
    fit, _ = robust(rows_of(crossings, groups_of(crossings), apart, At(), height), apart)
    gap = float(fit.psi[0] - fit.psi[1])
    sigma = float(np.sqrt(fit.cov[0, 0] + fit.cov[1, 1] - 2.0 * fit.cov[0, 1]))
    if abs(gap) < _DELAY_S or abs(gap) < _CLEARLY * sigma:
        return model, []
    sense = "earlier" if gap > 0.0 else "later"
    return apart, [
        ("laser.delay", f"the input is {1e3 * abs(gap):.2f} ms {sense} than it was in the reference")
    ]


def _freed(model: LateralModel, crossings: Crossings, height: Heights) -> LateralModel:
    """``model`` with those tilts freed that one height expects to be none and that clearly are some."""
    doubted = {f"tilt {b}" for b in model.hints} | {f"own tilt {b}" for b in model.hints}
    doubted &= set(model.names)
    if not doubted:
        return model
    loose = replace(model, free=tuple(name for name in model.names if name in doubted))
    fit, _ = robust(rows_of(crossings, groups_of(crossings), loose, At(), height), loose)
    clear = [
        name
        for k, name in enumerate(model.names)
        if name in doubted and abs(fit.psi[k]) > _CLEARLY * np.sqrt(fit.cov[k, k])
    ]
    return replace(model, free=tuple(clear))
