"""Which crossings tell where the tool is across the beams, and why the others do not."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calibration.tool_frame.crossings import MAX_SPEED_CHANGE, Crossing, PassContents
from calibration.tool_frame.geometry import BEAMS
from calibration.tool_frame.scene import ToolFrameScene

_SAME_HEIGHT_M = 2e-5
_END_M = 2e-4  # an arm that repeats badly meets a tool one time and not the next over so great a height
_SEARCHED_M = 3e-3  # hits and misses of a search in height are nearer to each other: it begins 2 mm above
_NEAR_TIP = 0.6  # of the chord: so far above the tip a shorter chord is the tip's rounding
_ROUND_END = 0.5  # of a finger's chord: from here on a round end is as wide as the finger
_ANOTHER_HEIGHT_M = 2e-4
_LATE = 1.5  # times the usual time between the polls around an edge


@dataclass(frozen=True, eq=False)
class Selection:
    """``across`` are the places of the crossings in use across the beams; ``grazing`` those that met the
    tip alone, or may have, and tell the height only; ``hits`` and ``missed`` tell the height.
    ``reasons`` for the rest."""

    across: Sequence[int]
    grazing: Sequence[int]
    hits: Sequence[int]
    missed: Sequence[int]
    reasons: Mapping[int, str]


def select(scene: ToolFrameScene, seen: PassContents) -> Selection:
    """Passes without their return edges, with changing speed or grazing the tip are sorted out."""
    reasons = dict(seen.reasons)
    alone = _without_return(scene, seen)
    chance = _at_the_end(scene, seen, alone)
    for k in alone - chance:
        reasons[k] = "the way there and the way back do not both show the tool"
    hits = [k for k in (*seen.crossings, *seen.partial) if k not in alone]
    missed = [k for k in seen.missed if k not in alone]
    steady = []
    for k in [k for k in hits if k in seen.crossings]:
        change = seen.crossings[k].speed_change
        if np.isinf(change):
            reasons[k] = "the arm did not move across the beam at the times of the polls"
        elif change > MAX_SPEED_CHANGE:
            reasons[k] = f"the speed changed by {100.0 * change:.0f} % while the tool crossed the beam"
        else:
            steady.append(k)
    grazing = _grazing(scene, seen, steady) | {k for k in chance if k in seen.crossings}
    for k in grazing:
        chord = seen.crossings[k].chord
        reasons[k] = f"met the tip alone: its chord of {1e3 * chord:.2f} mm is shorter than the others'"
        if k in chance:
            reasons[k] = "met the tip alone: one way of two"
    across = [k for k in steady if k not in grazing]
    unclear = _not_shown(seen, across, grazing)
    reasons |= dict.fromkeys(unclear, "near the end, polls came too late to show how wide the tool is there")
    across = [k for k in across if k not in unclear]
    return Selection(across, sorted(grazing | unclear), hits, missed, reasons)


def _not_shown(seen: PassContents, across: Sequence[int], grazing: set[int]) -> set[int]:
    """Crossings near the tool's end with late polls at their edges.

    How wide the tool is there differs from height to height. Where polls came as usual, too short a chord
    shows; with late ones anything fits, and its middle is not that of the tool.
    """
    found: set[int] = set()
    for beam in BEAMS:
        for current in (False, True):
            own = _of({k: seen.crossings[k] for k in across}, beam, current)
            met = own | _of({k: seen.crossings[k] for k in grazing}, beam, current)
            near = _near_end(own, met)
            usual = float(np.median([c.slack / c.speed for c in own.values()])) if near else 0.0
            found |= {k for k in near if own[k].slack / own[k].speed > _LATE * usual}
    return found


def _without_return(scene: ToolFrameScene, seen: PassContents) -> set[int]:
    """Both passes of each there-and-back of which only one shows the tool."""
    found: set[int] = set()
    for current in (False, True):
        for beam in BEAMS:
            own = [k for k, p in enumerate(scene.passes) if p.beam == beam and p.current == current]
            own.sort(key=lambda k: float(scene.passes[k].pose_t[0]))
            k = 0
            while k + 1 < len(own):
                a, b = scene.passes[own[k]], scene.passes[own[k + 1]]
                same = abs(float(a.middle[2] - b.middle[2])) < _SAME_HEIGHT_M
                if a.direction == b.direction or not same or a.direction != 1:
                    k += 1
                    continue
                pair = (own[k], own[k + 1])
                states = {j in seen.missed for j in pair}
                decided = all(j in seen.crossings or j in seen.missed or j in seen.partial for j in pair)
                if decided and len(states) == 2:
                    found |= {own[k], own[k + 1]}
                k += 2
    return found


def _at_the_end(scene: ToolFrameScene, seen: PassContents, alone: set[int]) -> set[int]:
    """Those of ``alone`` that are so near the tool's end that an arm meets it one time and not the next."""
    found: set[int] = set()
    for current in (False, True):
        for beam in BEAMS:
            own = [k for k, p in enumerate(scene.passes) if p.beam == beam and p.current == current]
            height = {k: float(scene.passes[k].middle[2]) for k in own}
            met = [height[k] for k in own if k not in alone and k in seen.crossings]
            missed = [height[k] for k in own if k not in alone and k in seen.missed]
            low = max(met, default=np.inf)
            high = min([h for h in missed if h > low - _END_M], default=np.inf)
            if high - low < _SEARCHED_M:
                found |= {k for k in own if k in alone and low - _END_M <= height[k] <= high + _END_M}
    return found


def _grazing(scene: ToolFrameScene, seen: PassContents, steady: Sequence[int]) -> set[int]:
    """Crossings near the tip whose chord is clearly shorter than those further up the tool."""
    found: set[int] = set()
    for beam in BEAMS:
        for current in (False, True):
            own = [k for k in steady if scene.passes[k].beam == beam and scene.passes[k].current == current]
            if len(own) < 2:
                continue
            crossings = [seen.crossings[k] for k in own]
            depth = -np.array([float(np.mean(c.above)) for c in crossings])
            tip = float(np.min(depth))
            full = _full_chord(crossings, depth)
            for k, c, d in zip(own, crossings, depth, strict=True):
                short = c.chord + c.slack + 6.0 * c.noise < full - 1e-6
                if short and d - tip < _NEAR_TIP * full:
                    found.add(k)
    return found


def _full_chord(crossings: Sequence[Crossing], depth: np.ndarray) -> float:
    """The chord away from the tip, at its smallest that the intervals allow."""
    far = depth > np.max(depth) - 0.5 * max(float(np.ptp(depth)), 1e-9) - _SAME_HEIGHT_M
    picked = [c for c, use in zip(crossings, far, strict=True) if use]
    return float(np.median([c.chord - c.slack for c in picked]))


def marked_near_end(crossings: Mapping[int, Crossing], met: Mapping[int, Crossing]) -> dict[int, Crossing]:
    """``crossings`` with names of the heights at which a round end is narrower; ``met`` are all that met the
    tool, also those that met its end alone.

    How much narrower, polls at the speed of a search do not tell; and taken for the width of the tool, it
    would look as if the input cleared early at that speed.
    """
    found = dict(crossings)
    for beam in BEAMS:
        for current in (False, True):
            near = _near_end(_of(crossings, beam, current), _of(met, beam, current))
            number, last = 0, -np.inf
            for k in near:
                depth = -float(np.mean(crossings[k].above))
                number += depth - last > _ANOTHER_HEIGHT_M
                last = depth
                name = f"{'current' if current else 'reference'} {beam} {number}"
                found[k] = replace(crossings[k], near_end=name)
    return found


def _near_end(own: Mapping[int, Crossing], met: Mapping[int, Crossing]) -> list[int]:
    """The places of those of ``own`` that are near the end, which is no lower than the highest of ``met``; in
    their order upwards from the end. None when all are."""
    if not own:
        return []
    end = max(float(np.mean(c.above)) for c in met.values())
    depth = {k: end - float(np.mean(c.above)) for k, c in own.items()}
    deepest = max(depth.values())
    far = [own[k] for k, d in depth.items() if d > deepest - _ANOTHER_HEIGHT_M]
    finger = float(np.median([np.max(np.diff(c.middle)[::2]) for c in far]))
    near = sorted((k for k in own if depth[k] < _ROUND_END * finger), key=lambda k: depth[k])
    return [] if len(near) == len(own) else near


def _of(crossings: Mapping[int, Crossing], beam: str, current: bool) -> dict[int, Crossing]:
    return {k: c for k, c in crossings.items() if (c.source.beam, c.source.current) == (beam, current)}
