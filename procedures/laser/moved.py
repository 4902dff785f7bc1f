"""Whether the tool has moved: what was measured against the frame in effect, held against a tolerance.

A measurement differs a little from the one before though nothing moved. The tolerance is what separates
that from a tool that moved: the longest difference that a tool which has not moved shows but once in so many
checks, and never less than what is configured, or a floor for what the covariance does not hold. A configured
tolerance below that difference would call good tools moved more often than is stated.
"""

from collections.abc import Mapping
from typing import Any

from pydantic import ValidationError

from calibration.lengths import length95, length_beyond
from calibration.odds import FALSE_ALARM
from calibration.tool_frame.meeting import detectable
from cell.errors import error
from cell.poses import Array
from procedures.laser.result import Apart, MovedTest

FLOOR_M = 0.0001  # twice the repeatability that makers state for arms of this size, in pose after pose
FLOOR_RAD = 0.002
_TESTS = 2  # of the point and of the axis, which share the chance of a false alarm


def by_chance(cov: Array, chance: float = FALSE_ALARM) -> float:
    """The length beyond which a difference with covariance ``cov`` (k, k) is no chance, in the unit of its
    root; ``chance`` is that of calling a tool moved that has not, by the point or by the axis."""
    return length_beyond(cov, chance / _TESTS)


def tolerance(
    cov: Array, floor: float, chance: float = FALSE_ALARM, configured: float | None = None
) -> float:
    """As :func:`by_chance`, and no less than what is ``configured``; ``floor`` where nothing is."""
    return max(by_chance(cov, chance), floor if configured is None else configured)


def against_effect(cov: Array, same_frame: bool) -> Array:
    """The covariance against the frame in effect from ``cov``, that against the reference. Where it is not
    the reference's (``same_frame``) the frame was measured as well, and is taken to be as uncertain."""
    return cov if same_frame else 2.0 * cov


def whether_moved(
    found: Apart, cov: Array, config: Mapping[str, Any], same_frame: bool, tilted: bool
) -> MovedTest:
    """The test of a check: how far the tool moved against the frame in effect, and the tolerance.

    ``found`` is against the frame in effect, and ``cov`` (6, 6) is that of the measurement against the
    reference. ``same_frame``: the frame in effect is the reference's. ``false_alarm`` of ``config`` is the
    chance that the tolerances keep; ``tolerance_m`` and ``tolerance_rad`` make them larger than that takes. A
    shift of ``detectable_m`` is found with 99 % at least. Without a tilt (``tilted``) the axis is not tested.
    ``SOLVE_REFUSED`` when a figure is no finite number: it would compare as not moved.
    """
    both = against_effect(cov, same_frame)
    point, axis = both[:3, :3], both[3:, 3:]
    chance = config.get("false_alarm", FALSE_ALARM)
    limit = tolerance(point, FLOOR_M, chance, config["tolerance_m"])
    turn = tolerance(axis, FLOOR_RAD, chance, config["tolerance_rad"]) if tilted else None
    try:
        return MovedTest(
            moved=bool(found.shift > limit or (turn is not None and found.tilt_rad > turn)),
            shift_m=found.shift,
            U_shift_m=length95(point),
            tolerance_m=limit,
            detectable_m=detectable(point, limit),
            false_alarm=chance,
            tilt_rad=found.tilt_rad if tilted else None,
            U_tilt_rad=length95(axis) if tilted else None,
            tolerance_rad=turn,
        )
    except ValidationError as exc:
        names = ", ".join(str(wrong["loc"][0]) for wrong in exc.errors(include_url=False))
        raise error("SOLVE_REFUSED", f"{names} of the check is not a finite number") from exc
