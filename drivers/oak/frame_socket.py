"""Reads frame groups from a unix stream socket."""

import json
import math
import socket
import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cell.devices import Intrinsics
from cell.errors import error

MAX_HEADER = 65536
POLL_S = 0.2


@dataclass(frozen=True)
class FrameGroup:
    """One exposure: colour (h, w, 3) BGR, and depth (h, w) in mm or None."""

    seq: int
    t_exposure: float
    exposure_s: float
    intrinsics: Intrinsics
    serial: str
    colour: NDArray[np.uint8]
    depth: NDArray[np.uint16] | None
    row_time_s: float = 0.0
    lens_position: int | None = None  # None: not told, as of a lens that cannot move


class FrameSocket:
    """A connection to a frame server. ``running`` is asked while waiting, so that a reader can be ended."""

    def __init__(self, path: str, running: Callable[[], bool] = lambda: True) -> None:
        self.path, self.running = path, running
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._socket.settimeout(POLL_S)
        try:
            self._socket.connect(path)
        except OSError as exc:
            self._socket.close()
            raise error(
                "DEVICE_UNREACHABLE", f"no frame server listens on {path}: {exc.strerror or exc}"
            ) from exc

    def close(self) -> None:
        """End the connection."""
        self._socket.close()

    def read(self) -> FrameGroup | None:
        """The next group; None when ``running`` became false.

        ``DEVICE_LOST`` when the server closed, ``PROTOCOL_VIOLATION`` for bytes that are no frame group.
        """
        prefix = self._exactly(4)
        if prefix is None:
            return None
        (length,) = struct.unpack("<I", prefix)
        if not 2 <= length <= MAX_HEADER:
            raise error("PROTOCOL_VIOLATION", f"{self.path}: a frame header of {length} bytes")
        raw = self._exactly(length)
        if raw is None:
            return None
        header = self._header(bytes(raw))
        width, height = header["width"], header["height"]
        colour = self._exactly(3 * width * height)
        if colour is None:
            return None
        depth = bytearray() if header["depth"] is None else self._exactly(2 * width * height)
        if depth is None:
            return None
        return FrameGroup(
            seq=header["seq"],
            t_exposure=float(header["t_exposure"]),
            exposure_s=float(header["exposure_s"]),
            row_time_s=float(header.get("row_time_s", 0.0)),
            intrinsics=Intrinsics(width, height, tuple(header["K"]), tuple(header["dist"])),
            serial=header["serial"],
            lens_position=header.get("lens_position"),
            colour=np.frombuffer(colour, np.uint8).reshape(height, width, 3),
            depth=np.frombuffer(depth, "<u2").reshape(height, width) if depth else None,
        )

    def _exactly(self, count: int) -> bytearray | None:
        data = bytearray(count)
        view, filled = memoryview(data), 0
        while filled < count:
            try:
                got = self._socket.recv_into(view[filled:])
            except TimeoutError:
                if not self.running():
                    return None
                continue
            except OSError as exc:
                raise error("DEVICE_LOST", f"{self.path}: {exc.strerror or exc}") from exc
            if not got:
                raise error("DEVICE_LOST", f"the frame server on {self.path} closed the connection")
            filled += got
        return data

    def _header(self, raw: bytes) -> dict[str, Any]:
        try:
            header = json.loads(raw)
            problem = _header_problem(header)
        except (ValueError, KeyError, TypeError) as exc:
            problem = f"{type(exc).__name__} {exc}"
        if problem:
            raise error("PROTOCOL_VIOLATION", f"{self.path}: frame header {raw[:60]!r}: {problem}")
        return dict(header)


def _header_problem(header: Any) -> str | None:
    """What is wrong with a parsed header, or None."""
    numbers = [header["t_exposure"], header["exposure_s"], header.get("row_time_s", 0.0)]
    numbers += [*header["K"], *header["dist"]]
    if not all(isinstance(n, int | float) and math.isfinite(n) for n in numbers):
        return "a number is not finite"
    if not all(isinstance(header[k], int) and 64 <= header[k] <= 8192 for k in ("width", "height")):
        return "width and height must be 64 to 8192"
    if not isinstance(header.get("lens_position"), int | None):
        return "lens_position is not a whole number"
    if not isinstance(header["seq"], int) or not isinstance(header["serial"], str):
        return "seq must be a whole number and serial a text"
    if len(header["K"]) != 4 or len(header["dist"]) not in (0, 4, 5, 8, 12, 14):
        return "K has 4 and dist 0, 4, 5, 8, 12 or 14 entries"
    if header["colour"] != "bgr8" or header["depth"] not in ("u16mm", None):
        return "colour must be bgr8, depth u16mm or null"
    return None
