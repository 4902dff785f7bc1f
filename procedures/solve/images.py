"""Images of a data set: found inside its folder, read, and refused with a sentence when they are not good."""

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.targets.base import Image
from cell.errors import error

MAX_BYTES = 200_000_000


def resolve_inside(folder: Path, name: str, field: str) -> Path:
    """The file ``name`` below ``folder``; ``field`` says where the name stands in the data set."""
    path = (folder / name).resolve()
    if Path(name).is_absolute() or not path.is_relative_to(folder.resolve()):
        raise error(
            "DATA_INVALID",
            f"{field} is {name!r}, which leads out of {folder}; files must lie beside the data set",
        )
    if not path.is_file():
        raise error("FILE_MISSING", f"{path}, named by {field}, does not exist; restore it or take it out")
    return path


def read_grey(path: Path, field: str) -> Image:
    """An image as 8-bit grey (h, w)."""
    try:
        if path.stat().st_size > MAX_BYTES:
            raise error("FILE_UNREADABLE", f"{path}, named by {field}, is larger than {MAX_BYTES} bytes")
        raw = np.fromfile(path, dtype=np.uint8)
        image = _decode(raw) if raw.size else None
    except (OSError, cv2.error) as exc:
        raise error("FILE_UNREADABLE", f"{path}, named by {field}, cannot be read: {exc}") from exc
    if image is None:
        raise error(
            "FILE_UNREADABLE",
            f"{path}, named by {field}, is not an intact image; replace it or take the observation out",
        )
    return np.asarray(image, dtype=np.uint8)


def _decode(raw: NDArray[np.uint8]) -> Image | None:
    """The image, or None; OpenCV's own lines on stderr are left out, since the error says it better."""
    level = cv2.utils.logging.getLogLevel()
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        return cv2.imdecode(raw, cv2.IMREAD_GRAYSCALE)
    finally:
        cv2.utils.logging.setLogLevel(level)
