"""Images on disk: whole or not at all."""

import os
from pathlib import Path
from typing import Any

import cv2
from numpy.typing import NDArray

from cell.errors import error

# Run lengths only: noisy pictures gain nothing from a search for matches, which takes twice as long.
_FAST = [cv2.IMWRITE_PNG_COMPRESSION, 1, cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE]


def write_png(path: Path, image: NDArray[Any]) -> None:
    """Write ``image`` (8 or 16 bit) losslessly: temporary name, fsync, rename. The folder is not synced."""
    ok, data = cv2.imencode(".png", image, _FAST)
    if not ok:
        raise error("INTERNAL", f"an image of shape {image.shape} and type {image.dtype} is no PNG")
    temporary = path.with_name(f".{path.name}.part")
    with open(temporary, "wb") as file:
        file.write(data.tobytes())
        file.flush()
        os.fsync(file.fileno())
    os.replace(temporary, path)


def sync_folder(folder: Path) -> None:
    """Make the names in ``folder`` survive a power cut."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
