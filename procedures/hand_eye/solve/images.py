"""Images of a data set: found inside its folder, read, and refused with a sentence when they are not good."""

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.targets.base import Image
from cell.errors import error
from procedures.hand_eye.solve.image_size import image_size

MAX_BYTES = 200_000_000
MAX_PIXELS = 200_000_000


def resolve_inside(folder: Path, name: str, field: str) -> Path:
    """The file ``name`` below ``folder``; ``field`` says where the name stands in the data set."""
    try:
        path = (folder / name).resolve()
        is_file = path.is_file()
    except (OSError, ValueError, RuntimeError) as exc:  # too long, half a character, a NUL, a ring of links
        raise error("DATA_INVALID", f"{field} is {name[:60]!r}, which is no name of a file ({exc})") from exc
    if Path(name).is_absolute() or not path.is_relative_to(folder.resolve()):
        raise error(
            "DATA_INVALID",
            f"{field} is {name!r}, which leads out of {folder}; files must lie beside the data set",
        )
    if not is_file:
        raise error("FILE_MISSING", f"{path}, named by {field}, does not exist; restore it or take it out")
    return path


def read_grey(path: Path, field: str, wanted: tuple[int, int] | None = None) -> Image:
    """An image as 8-bit grey (h, w).

    One whose header gives more than ``MAX_PIXELS``, or other sides than ``wanted`` (width, height; a camera
    held upright may note that), is refused before it is decoded: a small file may unpack to gigabytes.
    """
    try:
        if path.stat().st_size > MAX_BYTES:
            raise error("FILE_UNREADABLE", f"{path}, named by {field}, is larger than {MAX_BYTES} bytes")
        raw = np.fromfile(path, dtype=np.uint8)
        _check_header(raw, path, field, wanted)
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


def _check_header(raw: NDArray[np.uint8], path: Path, field: str, wanted: tuple[int, int] | None) -> None:
    if not raw.size:
        return
    size = image_size(raw.tobytes())
    if size is None:
        raise error(
            "FILE_UNREADABLE",
            f"{path}, named by {field}, is not an intact image (PNG, JPEG, BMP, TIFF or PNM); replace "
            "it or take the "
            "observation out",
        )
    width, height = size
    if wanted is not None and sorted(size) != sorted(wanted):
        raise error("DATA_INVALID", other_size(field, path.name, size, wanted))
    if width * height > MAX_PIXELS:
        raise error(
            "FILE_UNREADABLE",
            f"{path}, named by {field}, has {width}x{height} pixels, more than the {MAX_PIXELS} allowed",
        )


def other_size(field: str, name: str, size: tuple[int, int], wanted: tuple[int, int]) -> str:
    """The sentence for an image that is not of the camera."""
    return (
        f"{field} is {name!r} with {size[0]}x{size[1]} pixels, but the camera has {wanted[0]}x{wanted[1]}; "
        "give images of the size that the intrinsics belong to"
    )
