"""What the ways across the beams leave open: without a way back, a delay looks like a displacement.

A late input shifts all edges along the way, whichever way that is. Ways there and back tell it; where both
sets went the same way only it cancels in the comparison, as long as it is what it was; and where the sets
went opposite ways it is in the answer twice over.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from calibration.tool_frame.crossings import Crossing
from calibration.tool_frame.geometry import BEAMS
from calibration.tool_frame.scene import Refused

UNSEEN_DELAY = "delay of the input, and hysteresis (no set crosses a beam both ways)"


@dataclass(frozen=True)
class Ways:
    """Whether some set crossed some beam both ways, so that the delay is seen; and warnings."""

    delay_seen: bool
    warnings: tuple[tuple[str, str], ...] = ()


def compared_ways(crossings: Mapping[int, Crossing]) -> Ways:
    """Of a reference and a current set; refused where delay and displacement cannot be told apart."""
    sets = {(b, current): _senses(crossings, b, current) for b in BEAMS for current in (False, True)}
    warnings = []
    seen = any(len(senses) == 2 for senses in sets.values())
    for beam in BEAMS:
        before, now = sets[beam, False], sets[beam, True]
        if len(before) == len(now) == 2:
            continue
        if not before & now and not seen:
            raise Refused(
                "no-return",
                f"the reference crosses beam {beam} one way only and the current passes the other way; a "
                "delay of the input cannot be told from a displacement. Cross it there and back",
            )
        lone = " and ".join(w for w, senses in (("reference", before), ("current", now)) if len(senses) == 1)
        warnings.append(
            (
                "laser.one-way",
                f"the {lone} passes cross beam {beam} one way only; if the input's delay or hysteresis is "
                "not what it was, the difference is in the answer unseen. Cross it there and back",
            )
        )
    return Ways(seen, tuple(warnings))


def refuse_one_way(crossings: Mapping[int, Crossing]) -> None:
    """Of a reference by itself: where a beam is cannot be told without a way back."""
    for beam in BEAMS:
        if len(_senses(crossings, beam, False)) == 1:
            raise Refused(
                "no-return",
                f"beam {beam} is crossed one way only; a delay of the input cannot be told from the place of "
                "the beam. Cross it there and back",
            )


def _senses(crossings: Mapping[int, Crossing], beam: str, current: bool) -> set[int]:
    return {
        int(np.sign(np.sum(c.v)))
        for c in crossings.values()
        if c.source.beam == beam and c.source.current == current
    }
