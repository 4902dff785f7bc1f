"""A belt and picks from it beside the twin's truth: its motion, and where the tool truly met each item."""

from collections.abc import Mapping
from math import atan2, degrees, pi, remainder
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import bdtr

from cell.errors import error
from cell.poses import Array
from procedures.belt.result import BeltCalibrationResult, BeltTrackingResult
from procedures.beside_truth import SURE_SCALAR, Judged, all_inside
from procedures.words import table

WANTED_M = 0.001  # RMS of the contacts, horizontal
LARGEST = "the largest contact"
TRAVEL, DIRECTION, RISE = "travel of one count", "direction", "rise"


def judge_belt(result: BeltCalibrationResult, truth: Mapping[str, Any], folder: Path) -> Judged:
    """Travel of one count, direction seen from above and its rise against the true ones, within their stated
    95 % limits. The row has no rise, which moves no contact beside its item."""
    found, true = result.result, truth["belt"]
    half, (turn95, rise95) = result.uncertainty.half_m_per_count, result.direction_95_rad()
    if half is None or turn95 is None or rise95 is None:
        raise error("SOLVE_REFUSED", "the result has no uncertainty")
    off = abs(found.m_per_count - true["m_per_count"]) / abs(true["m_per_count"])
    share = half / abs(true["m_per_count"])
    turn, rise = _turned(np.array(found.dir), np.array(true["dir"]))
    of95 = {TRAVEL: off / share, DIRECTION: turn / turn95, RISE: rise / rise95}
    good = all(part <= SURE_SCALAR for part in of95.values())
    stated = f"{TRAVEL} {100 * share:.3f} %, {DIRECTION} {degrees(turn95):.3f} deg (95 %)"
    apart = f"{TRAVEL} {100 * off:.3f} %, {DIRECTION} {degrees(turn):.3f} deg"
    words = "consistent with" if good else "NOT consistent with"
    text = (
        f"off by: {apart}, {RISE} {degrees(rise):.3f} deg\n{words} the stated limits, {stated}, "
        f"{RISE} {degrees(rise95):.3f} deg"
    )
    limits95 = {TRAVEL: (share, "1"), DIRECTION: (turn95, "rad"), RISE: (rise95, "rad")}
    return Judged(good, text, stated, apart, all_inside(of95), of95, limits95)


def _turned(found: Array, true: Array) -> tuple[float, float]:
    """By how much a direction (3,) is off another one seen from above, and by how much more it rises, rad."""
    level = atan2(found[1], found[0]) - atan2(true[1], true[0])
    rise = atan2(found[2], float(np.linalg.norm(found[:2]))) - atan2(true[2], float(np.linalg.norm(true[:2])))
    return abs(remainder(level, 2.0 * pi)), abs(rise)


def judge_picks(result: BeltTrackingResult, truth: Mapping[str, Any], folder: Path) -> Judged:
    """How far the tool's point was beside the item at each first contact, and how fast the item slid then.

    Good when every pick that the job counts was one, and the contacts are within ``WANTED_M``.
    """
    closings = truth["gripper"]["contacts"]
    taken = sum(bool(c["taken"]) for c in closings)
    met = [c for c in closings if c["off_m"] is not None]  # the tool came down to the item's face, or took it
    picks = result.result.picks
    off = np.array([c["off_m"] for c in met]).reshape(-1, 2)
    slide = np.array([c["slide_m_s"] or 0.0 for c in met])
    direction = np.array(truth["belt"]["dir"][:2])
    along = off @ direction
    across = off @ np.array([-direction[1], direction[0]])
    total = np.linalg.norm(off, axis=1)
    apart = float(np.sqrt(np.mean(total**2))) if len(met) else float("inf")
    good = picks > 0 and picks == taken and apart <= WANTED_M
    rows = [
        (name, f"{1e3 * np.sqrt(np.mean(v**2)):.3f}", f"{1e3 * np.max(np.abs(v)):.3f}")
        for name, v in (
            ("along, mm", along),
            ("across, mm", across),
            ("distance, mm", total),
            ("slide, mm/s", slide),
        )
        if len(met)
    ]
    words = "which is" if good else "which is NOT"
    text = [
        f"{picks} picks were counted; the twin's gripper truly took {taken} items in {len(closings)} "
        f"closings; in {len(met)} the tool had come down to the item's face",
        "the tool's point beside the item's own at first contact, and the slide when the fingers closed",
        table(("", "RMS", "largest"), rows),
        f"{words} what is wanted: every counted pick a true one, contacts within {1e3 * WANTED_M:g} mm RMS",
    ]
    at_contact = f"{1e3 * apart:.3f} mm RMS at contact" if len(met) else "none met"
    told, off_text = f"{picks} picks", f"{taken} taken, {at_contact}"
    inside95, of95, limits95 = None, {}, {}
    uncovered: tuple[str, ...] = ()
    if (stated := result.result.contact_95_m) is not None and len(met):
        within = int(np.sum(total <= stated))
        uncovered = tuple(result.result.contact_95_without or ())
        without = "".join(f"; without {what}" for what in uncovered)
        text.append(f"stated were {1e3 * stated:.3f} mm for 95 of 100 contacts{without}")
        text.append(f"{within} of {len(met)} are within")
        told += f", contact within {1e3 * stated:.3f} mm (95 %{', not all covered' if without else ''})"
        off_text += f", {within} of {len(met)} within"
        inside95 = bool(bdtr(within, len(met), 0.95) > 0.05)  # no fewer than chance lets
        of95 = {LARGEST: float(total.max()) / stated}
        limits95 = {LARGEST: (stated, "m")}
    return Judged(good, "\n".join(text), told, off_text, inside95, of95, limits95, uncovered)
