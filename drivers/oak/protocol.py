"""What the daemon and the vision child say to each other: JSON objects, each after its length.

To the child: ``configure`` once, with the target and the items to begin with, then ``target``, ``items`` and
``capture``, each with an ``id`` that the ``answer`` repeats. From the child: ``ready`` with the identity at
the first frame, a ``frame`` for every exposure, ``failed`` with a coded error before it ends by itself.
Pixels never cross.
"""

import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from cell.devices import BoardView, Frame, Intrinsics, ItemView
from cell.errors import CellError, catalogue, error

Message = dict[str, Any]
LENGTH = struct.Struct("<I")
MAX_BYTES = 4_000_000


def pack(message: Message) -> bytes:
    """``message`` with its length before it."""
    body = json.dumps(message, allow_nan=False).encode()
    return LENGTH.pack(len(body)) + body


def body_length(prefix: bytes) -> int:
    """The length in ``prefix``; ``PROTOCOL_VIOLATION`` beyond the limit."""
    (length,) = LENGTH.unpack(prefix)
    if length > MAX_BYTES:
        raise error("PROTOCOL_VIOLATION", f"the vision child announces a message of {length} bytes")
    return int(length)


def unpack(body: bytes) -> Message:
    """The object in ``body``; ``PROTOCOL_VIOLATION`` for anything else."""
    try:
        message = json.loads(body)
    except ValueError:
        message = None
    if not isinstance(message, dict) or not isinstance(message.get("type"), str):
        raise error("PROTOCOL_VIOLATION", f"the vision child sent {body[:60]!r}")
    return message


def read_message(read: Callable[[int], bytes]) -> Message | None:
    """The next message from a blocking file's ``read``; None when the other side closed."""
    prefix = read(LENGTH.size)
    if len(prefix) < LENGTH.size:
        return None
    length = body_length(prefix)
    body = read(length)
    return unpack(body) if len(body) == length else None


def error_to_json(exc: Exception) -> Message:
    """Name and detail of a coded error; anything else is a defect and says its type."""
    if isinstance(exc, CellError):
        return {"name": exc.name, "detail": exc.detail}
    return {"name": "INTERNAL", "detail": f"vision child: {type(exc).__name__}: {exc}"}


def error_from_json(message: Message) -> CellError:
    """Inverse of :func:`error_to_json`."""
    name = message.get("name")
    return error(name if name in catalogue() else "INTERNAL", str(message.get("detail", "")))


def frame_to_json(frame: Frame) -> Message:
    """A :class:`Frame` as plain values."""
    board = frame.board
    return {
        "seq": frame.seq,
        "t_exposure": frame.t_exposure,
        "exposure_s": frame.exposure_s,
        "row_time_s": frame.row_time_s,
        "width": frame.intrinsics.width,
        "height": frame.intrinsics.height,
        "K": list(frame.intrinsics.K),
        "dist": list(frame.intrinsics.dist),
        "serial": frame.serial,
        "board": board
        and {"ids": board.ids.tolist(), "corners": board.corners.tolist(), "mean_grey": board.mean_grey},
        "colour_file": frame.colour_file and str(frame.colour_file),
        "depth_file": frame.depth_file and str(frame.depth_file),
        "items": None if frame.items is None else [_item_to_json(item) for item in frame.items],
    }


def frame_from_json(message: Message) -> Frame:
    """Inverse of :func:`frame_to_json`."""
    board = message["board"]
    fx, fy, cx, cy = message["K"]
    return Frame(
        seq=message["seq"],
        t_exposure=message["t_exposure"],
        exposure_s=message["exposure_s"],
        row_time_s=message["row_time_s"],
        intrinsics=Intrinsics(message["width"], message["height"], (fx, fy, cx, cy), tuple(message["dist"])),
        board=board
        and BoardView(
            np.array(board["ids"], dtype=np.int64),
            np.array(board["corners"], dtype=float).reshape(-1, 2),
            board["mean_grey"],
        ),
        serial=message["serial"],
        colour_file=message["colour_file"] and Path(message["colour_file"]),
        depth_file=message["depth_file"] and Path(message["depth_file"]),
        items=None if message["items"] is None else tuple(_item_from_json(item) for item in message["items"]),
    )


def _item_to_json(item: ItemView) -> Message:
    return {
        "point": item.point.tolist(),
        "axis": item.axis.tolist(),
        "size_m": list(item.size_m),
        "height_m": item.height_m,
        "sigma_m": item.sigma_m,
    }


def _item_from_json(message: Message) -> ItemView:
    length, width = message["size_m"]
    return ItemView(
        point=np.array(message["point"], dtype=float),
        axis=np.array(message["axis"], dtype=float),
        size_m=(length, width),
        height_m=message["height_m"],
        sigma_m=message["sigma_m"],
    )
