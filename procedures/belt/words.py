"""Belt calibration and picking in words."""

from collections.abc import Mapping
from math import atan2, degrees
from typing import Any

from procedures.words import mm, told

_UM = 1e6


def belt_calibration_lines(result: Mapping[str, Any], answer: Mapping[str, Any]) -> list[str]:
    """Scale and direction with their intervals, and what they rest on."""
    m, way = float(answer["m_per_count"]), answer["dir"]
    interval = answer.get("m_per_count_95")
    sure = "" if interval is None else f" (95 %: {_UM * interval[0]:.3f} to {_UM * interval[1]:.3f})"
    lines = [f"  one count moves the belt by {_UM * m:.3f} um{sure}"]
    turn = answer.get("dir_95_rad")
    within = "" if turn is None else f", within {1e3 * turn:.2f} mrad (95 %)"
    axes = ", ".join(f"{v:.5f}" for v in way)
    angle = degrees(atan2(way[1], way[0]))
    lines.append(f"  dir = [{axes}] in the base, {angle:.3f} deg from x{within}")
    lines.append(
        f"  from {told(answer.get('sightings'))} sightings of {told(answer.get('items'))} items over "
        f"{mm(answer.get('travel_m'))}"
    )
    heldout = (result.get("heldout") or {}).get("rms_m")
    if heldout is not None:
        lines.append(f"  sightings set aside: {mm(heldout)} RMS (residuals are not accuracy)")
    lines += [f"  not seen: {what}" for what in (result.get("observability") or {}).get("undetermined") or []]
    return lines


def belt_tracking_lines(_result: Mapping[str, Any], answer: Mapping[str, Any]) -> list[str]:
    """Picks, their rate, and what was missed."""
    rate, success = answer.get("picks_per_minute"), answer.get("success")
    line = f"  {told(answer.get('picks'))} picked of {told(answer.get('seen'))} seen"
    if rate is not None:
        line += f", {rate:.1f} a minute over {told(answer.get('duration_s'), '.0f')} s"
    lines = [line]
    if success is not None:
        lines.append(f"  {100 * success:.1f} % of those that were tried")
    lines += [f"  missed, {cause}: {count}" for cause, count in (answer.get("misses") or {}).items()]
    how = "moving with the item" if answer.get("follow") else "standing"
    return [*lines, f"  gripped {how}, method {told(answer.get('method'))}"]
