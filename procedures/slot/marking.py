"""The marker beside a slot as the configuration has it, and what keeps it from being seen."""

import cv2
import numpy as np

from calibration.slot.marker import SlotMarker
from calibration.targets import make_target
from cell.errors import CellError
from cell.poses import from_pose6
from procedures.slot.config import SlotInsertionConfig


def marker_of(config: SlotInsertionConfig) -> SlotMarker | None:
    """The one at the configured slot; None where the opening's edges tell where it is."""
    marker = config.marker
    if marker is None:
        return None
    cov = np.diag([marker.sigma_m**2] * 3 + [marker.sigma_rad**2] * 3)
    table = marker.target(config.slot)
    name = f"marker {table['id']} ({marker.dictionary})"
    cells = _dictionary(marker.dictionary).markerSize + 2  # with the black border
    place = from_pose6(marker.T_slot_marker)
    return SlotMarker(make_target(table), name, marker.size_m, cells, place, cov)


def marker_problem(config: SlotInsertionConfig) -> str | None:
    """Why no camera would find the marker of some slot, in words; None when nothing is wrong."""
    marker = config.marker
    if marker is None:
        return None
    try:
        make_target(marker.target(1))
    except CellError as exc:
        return f"marker.dictionary: {exc.detail}"
    known = len(_dictionary(marker.dictionary).bytesList)
    last = marker.id + config.rack.rows * config.rack.columns - 1
    if last >= known:
        return f"marker.id counts to {last} at the last slot, and {marker.dictionary} ends at {known - 1}"
    return None


def _dictionary(name: str) -> cv2.aruco.Dictionary:
    """One that :func:`.make_target` has accepted."""
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
