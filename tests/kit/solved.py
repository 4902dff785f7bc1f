"""The documents of results, as they are on disk, from data sets and from runs. Each is solved once."""

from typing import Any

from cell.formats.result import Envelope
from procedures import replay
from procedures.belt.calibrating import solving as belt
from procedures.belt.solve import solver as intercept
from procedures.eye_to_hand.solve import solver as axbc
from procedures.hand_eye.solve import solver as hand_eye
from procedures.iso9283 import judging as iso9283
from procedures.laser.solve import solver as laser
from procedures.latency import solver as latency
from procedures.tracker.solve import solver as kincal


def _document(found: Envelope) -> dict[str, Any]:
    return found.as_json()


def solve_hand_eye(*args: Any, calls: int = 1, **kwargs: Any) -> dict[str, Any]:
    return _document(hand_eye.solve_hand_eye(*args, calls=calls, **kwargs))


def solve_axbc(*args: Any, calls: int = 1, **kwargs: Any) -> dict[str, Any]:
    return _document(axbc.solve_axbc(*args, calls=calls, **kwargs))


def solve_laser(*args: Any, calls: int = 1, **kwargs: Any) -> dict[str, Any]:
    return _document(laser.solve_laser(*args, calls=calls, **kwargs))


def solve_reference(*args: Any, calls: int = 1, **kwargs: Any) -> dict[str, Any]:
    return _document(laser.solve_reference(*args, calls=calls, **kwargs))


def solve_kincal(*args: Any, calls: int = 1, **kwargs: Any) -> dict[str, Any]:
    return _document(kincal.solve_kincal(*args, calls=calls, **kwargs))


def solve_intercept(*args: Any, calls: int = 1, **kwargs: Any) -> dict[str, Any]:
    return _document(intercept.solve_intercept(*args, calls=calls, **kwargs))


def solve_iso9283(*args: Any, **kwargs: Any) -> dict[str, Any]:
    return _document(iso9283.solve_iso9283(*args, **kwargs))


def solve_latency(*args: Any, **kwargs: Any) -> dict[str, Any]:
    return _document(latency.solve_latency(*args, **kwargs))


def solve_belt(*args: Any, **kwargs: Any) -> dict[str, Any]:
    return _document(belt.solve_within_limits(*args, **kwargs))


def solve_again(*args: Any) -> dict[str, Any]:
    return _document(replay.solve_again(*args))
