"""Belt calibration and picking in words."""

from math import atan2, degrees

from procedures.belt.result import BeltCalibrationResult, BeltTrackingResult
from procedures.words import mm

_UM = 1e6


def belt_calibration_lines(found: BeltCalibrationResult) -> list[str]:
    """Scale and direction with their intervals, and what they rest on."""
    answer, way, interval = found.result, found.result.dir, found.result.m_per_count_95
    sure = "" if interval is None else f" (95 %: {_UM * interval[0]:.3f} to {_UM * interval[1]:.3f})"
    lines = [f"  one count moves the belt by {_UM * answer.m_per_count:.3f} um{sure}"]
    level, rise = found.direction_95_rad()
    within = "" if level is None else f", within {1e3 * level:.2f} mrad (95 %)"
    if rise is not None:
        within += f"; its rise within {1e3 * rise:.2f} mrad"
    axes = ", ".join(f"{v:.5f}" for v in way)
    angle = degrees(atan2(way[1], way[0]))
    lines.append(f"  dir = [{axes}] in the base, {angle:.3f} deg from x{within}")
    lines.append(f"  from {answer.sightings} sightings of {answer.items} items over {mm(answer.travel_m)}")
    if (heldout := found.heldout.rms_m) is not None:
        lines.append(f"  sightings set aside: {mm(heldout)} RMS (residuals are not accuracy)")
    return lines + [f"  not seen: {what}" for what in found.observability.undetermined]


def belt_tracking_lines(found: BeltTrackingResult) -> list[str]:
    """Picks, their rate, and what was missed."""
    answer = found.result
    line = f"  {answer.picks} picked of {answer.seen} seen"
    if answer.picks_per_minute is not None:
        line += f", {answer.picks_per_minute:.1f} a minute over {answer.duration_s:.0f} s"
    lines = [line]
    if answer.success is not None:
        lines.append(f"  {100 * answer.success:.1f} % of those that were tried")
    lines += [f"  missed, {cause}: {count}" for cause, count in answer.misses.items()]
    if answer.arm_lag_s is not None and answer.following_rms_m is not None:
        lines.append(
            f"  the arm is {1e3 * answer.arm_lag_s:.0f} ms late on its set-points, which is made up for; "
            f"during grips the tool was {mm(answer.following_rms_m)} RMS beside them"
        )
    if answer.contact_off_rms_m is not None and answer.contact_off_largest_m is not None:
        lines.append(
            f"  at contact items were {mm(answer.contact_off_rms_m)} RMS beside the tool's set-point, "
            f"{mm(answer.contact_off_largest_m)} at most, by later counts and pictures; "
            "errors of camera, calibration and arm are not in it"
        )
    if answer.contact_95_m is not None:
        shares = answer.contact_95_shares or {}
        parts = ", ".join(f"{name} {100 * share:.0f} %" for name, share in shares.items() if share >= 0.005)
        lines.append(
            f"  95 of 100 contacts are within {mm(answer.contact_95_m)} by all that is known ({parts} of its "
            f"square); not in it: {'; '.join(answer.contact_95_without or [])}"
        )
    if assumed := answer.contact_95_assumed:
        lines.append(f"  in it by an assumption, as it was not measured: {'; '.join(assumed)}")
    if (known := answer.camera_delay_95_s) is not None:
        lines.append(
            f"  the delay of the camera is known to {1e3 * known:.2f} ms (95 %): all contacts may be "
            f"off by {mm(0.1 * known)} along the belt for each 0.1 m/s"
        )
    if (off := answer.camera_95_m) is not None:
        lines.append(
            f"  by what is known of the camera's pose and lens all contacts may be off by {mm(off)} (95 %)"
        )
    if (waits := answer.place_waits) is not None and waits.count:
        lines.append(
            f"  waited {waits.count} times for a clear place, {waits.total_s:.1f} s together, "
            f"{waits.longest_s:.1f} s at most"
        )
    if (grid := answer.grid) is not None:
        left = f"place {grid.next} is next" if grid.next else "all are filled"
        lines.append(f"  {grid.filled} put into a grid of {grid.places} places, {left}")
    if answer.gripper_closing_s is not None:
        lines.append(f"  the gripper closed in {answer.gripper_closing_s:.2f} s")
    how = "moving with the item" if answer.follow else "standing"
    return [*lines, f"  gripped {how}, method {answer.method}"]
