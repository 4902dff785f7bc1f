"""A request for files of the next frames, written beside the looking."""

import errno
import threading
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from cell.devices import Frame
from cell.errors import CellError, error
from drivers.oak.files import sync_folder, write_png
from drivers.oak.protocol import Message, error_to_json, frame_to_json


class FrameCapture:
    """Takes the first ``count`` frames exposed wholly after ``after`` and writes them on ``writer``.

    ``answer`` gets the reply once, when everything is on disk or cannot be. Encoding takes as long as an
    exposure period, so it must not keep the next frame waiting.
    """

    def __init__(
        self, message: Message, writer: ThreadPoolExecutor, answer: Callable[[Message], None]
    ) -> None:
        self._count, self._after = int(message["count"]), float(message["after"])
        self._folder, self._stem = Path(message["folder"]), str(message["stem"])
        self._writer, self._answer = writer, answer
        self._frames: list[Frame] = []
        self._unwritten = self._count
        self._failed = False
        self._lock = threading.Lock()

    @property
    def complete(self) -> bool:
        """Whether all frames were taken, written or not; or none are wanted any more."""
        return self._failed or len(self._frames) == self._count

    def offer(self, frame: Frame, colour: NDArray[Any], depth: NDArray[Any] | None) -> None:
        """Take the frame if it is wanted; the arrays must not change afterwards."""
        if self.complete or frame.t_exposure - 0.5 * frame.exposure_s < self._after:
            return
        name = f"{self._stem}-{len(self._frames)}"
        colour_file, depth_file = self._folder / f"{name}.png", self._folder / f"{name}-depth.png"
        images = {colour_file: colour} if depth is None else {colour_file: colour, depth_file: depth}
        self._frames.append(
            replace(frame, colour_file=colour_file, depth_file=depth_file if depth_file in images else None)
        )
        self._writer.submit(self._write, images)

    def _write(self, images: Mapping[Path, NDArray[Any]]) -> None:
        try:
            for path, pixels in images.items():
                write_png(path, pixels)
            self._written()
        except OSError as exc:
            name = "DISK_FULL" if exc.errno in (errno.ENOSPC, errno.EDQUOT) else "DISK_FAILED"
            self._fail(error(name, f"{self._folder}: {exc.strerror or exc}"))
        except CellError as exc:
            self._fail(exc)

    def _written(self) -> None:
        with self._lock:
            self._unwritten -= 1
            last = self._unwritten == 0
        if last:
            sync_folder(self._folder)
            self._answer({"frames": [frame_to_json(f) for f in self._frames]})

    def _fail(self, exc: CellError) -> None:
        with self._lock:
            first, self._failed = not self._failed, True
        if first:
            self._answer({"error": error_to_json(exc)})
