"""The lens that was found with a camera's pose: beside another lens that pose puts things elsewhere."""

from collections.abc import Mapping
from typing import Any

from cell.devices import Intrinsics


def calibrated_lens(found: Mapping[str, Any] | None, told: Intrinsics) -> Intrinsics | None:
    """``found`` (``width``, ``height``, ``K``, ``dist``) by a calibration, or None where it has none for
    pictures of the size that is ``told``."""
    if found is None or (found["width"], found["height"]) != (told.width, told.height):
        return None
    fx, fy, cx, cy = found["K"]
    return Intrinsics(told.width, told.height, (fx, fy, cx, cy), tuple(found["dist"]))
