"""What crosses the pipe to the vision child, and what is accepted from a frame socket."""

import io
import json
import socket
import struct
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cell.devices import BoardView, Frame, Intrinsics
from cell.errors import CellError, error
from drivers.oak.config import OakConfig
from drivers.oak.frame_socket import FrameSocket
from drivers.oak.protocol import (
    error_from_json,
    error_to_json,
    frame_from_json,
    frame_to_json,
    pack,
    read_message,
)

numbers = st.floats(allow_nan=False, allow_infinity=False, width=64)
paths = st.none() | st.just(Path("/tmp/a b.png"))


@st.composite
def frames(draw: st.DrawFn) -> Frame:
    corners = draw(st.none() | st.lists(st.tuples(numbers, numbers), min_size=1, max_size=5))
    board = None
    if corners is not None:
        ids = draw(st.lists(st.integers(0, 2**40), min_size=len(corners), max_size=len(corners)))
        board = BoardView(np.array(ids, np.int64), np.array(corners, float), draw(numbers))
    K = draw(st.tuples(numbers, numbers, numbers, numbers))
    camera = Intrinsics(1280, 800, K, tuple(draw(st.lists(numbers, max_size=14))))
    return Frame(
        draw(st.integers(0)), draw(numbers), draw(numbers), camera, board, "9999", draw(paths), draw(paths)
    )


@given(frames())
def test_a_frame_comes_out_of_the_pipe_as_it_went_in(frame: Frame) -> None:
    message = {"type": "frame", "frame": frame_to_json(frame)}
    received = read_message(io.BytesIO(pack(message)).read)
    assert received is not None
    copy = frame_from_json(received["frame"])
    for name in ("seq", "t_exposure", "exposure_s", "intrinsics", "serial", "colour_file", "depth_file"):
        assert getattr(copy, name) == getattr(frame, name)
    assert (copy.board is None) == (frame.board is None)
    if frame.board is not None and copy.board is not None:
        assert (copy.board.ids == frame.board.ids).all()
        assert (copy.board.corners == frame.board.corners).all()
        assert copy.board.corners.shape == (len(frame.board.ids), 2)
        assert copy.board.mean_grey == frame.board.mean_grey


@pytest.mark.parametrize("cut", [0, 3, 4, 9])
def test_a_pipe_that_closes_ends_the_reading(cut: int) -> None:
    assert read_message(io.BytesIO(pack({"type": "frame"})[:cut]).read) is None


@pytest.mark.parametrize(
    "data",
    [struct.pack("<I", 2**31), struct.pack("<I", 3) + b"abc", struct.pack("<I", 2) + b"[]", pack({"a": 1})],
    ids=["endless", "no JSON", "no object", "no type"],
)
def test_bytes_that_are_no_message_are_a_violation(data: bytes) -> None:
    with pytest.raises(CellError) as caught:
        read_message(io.BytesIO(data).read)
    assert caught.value.name == "PROTOCOL_VIOLATION"


def test_a_coded_error_crosses_the_pipe_and_a_defect_is_called_one() -> None:
    copy = error_from_json(error_to_json(error("DEVICE_UNREACHABLE", "no camera")))
    assert (copy.name, copy.detail) == ("DEVICE_UNREACHABLE", "no camera")
    assert error_from_json(error_to_json(KeyError("x"))).name == "INTERNAL"
    assert error_from_json({"name": "NO_SUCH"}).name == "INTERNAL"


HEADER = {
    "seq": 5,
    "t_exposure": 12.5,
    "exposure_s": 0.008,
    "width": 64,
    "height": 64,
    "K": [50.0, 50.0, 31.5, 31.5],
    "dist": [],
    "colour": "bgr8",
    "depth": None,
    "serial": "99992200001",
}
PIXELS = bytes(range(256)) * 48


def group(header: Any, pixels: bytes = PIXELS) -> bytes:
    text = header if isinstance(header, bytes) else json.dumps(header).encode()
    return struct.pack("<I", len(text)) + text + pixels


@contextmanager
def serving(path: Path, data: bytes, running: Callable[[], bool] = lambda: True) -> Iterator[FrameSocket]:
    """A server that sends ``data`` and closes."""
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    listener.bind(str(path))
    listener.listen(1)

    def serve() -> None:
        connection, _ = listener.accept()
        with connection:
            connection.sendall(data)

    thread = threading.Thread(target=serve)
    thread.start()
    subject = FrameSocket(str(path), running)
    try:
        yield subject
    finally:
        subject.close()
        thread.join()
        listener.close()


def test_a_frame_group_is_read_with_its_pixels(tmp_path: Path) -> None:
    depth = np.arange(64 * 64, dtype="<u2")
    data = group(HEADER) + group({**HEADER, "seq": 6, "depth": "u16mm"}, PIXELS + depth.tobytes())
    with serving(tmp_path / "s", data) as subject:
        first, second = subject.read(), subject.read()
    assert first is not None
    assert second is not None
    assert (first.seq, first.t_exposure, first.serial, first.depth) == (5, 12.5, "99992200001", None)
    assert first.intrinsics == Intrinsics(64, 64, (50.0, 50.0, 31.5, 31.5))
    assert first.colour.tobytes() == PIXELS
    assert second.depth is not None
    assert (second.depth.ravel() == depth).all()


@pytest.mark.parametrize(
    "data",
    [
        bytes(range(256)) * 64,
        group(b"{not json"),
        group([1, 2]),
        group({k: v for k, v in HEADER.items() if k != "K"}),
        group({**HEADER, "width": 10**6}),
        group({**HEADER, "width": 64.5}),
        group({**HEADER, "seq": "5"}),
        group({**HEADER, "K": [1.0, 2.0]}),
        group({**HEADER, "dist": [0.1] * 6}),
        group({**HEADER, "t_exposure": "now"}),
        group(json.dumps(HEADER).replace("12.5", "NaN").encode()),
        group({**HEADER, "colour": "rgb8"}),
    ],
)
def test_a_header_that_is_not_to_the_format_is_a_violation(tmp_path: Path, data: bytes) -> None:
    with serving(tmp_path / "s", data) as subject, pytest.raises(CellError) as caught:
        subject.read()
    assert caught.value.name == "PROTOCOL_VIOLATION"


def test_a_server_that_closes_in_the_middle_of_a_frame_is_lost(tmp_path: Path) -> None:
    with serving(tmp_path / "s", group(HEADER)[:-1]) as subject, pytest.raises(CellError) as caught:
        subject.read()
    assert caught.value.name == "DEVICE_LOST"


def test_a_socket_that_nobody_serves_is_unreachable(tmp_path: Path) -> None:
    with pytest.raises(CellError) as caught:
        FrameSocket(str(tmp_path / "s"))
    assert caught.value.name == "DEVICE_UNREACHABLE"
    assert str(tmp_path / "s") in caught.value.detail


@pytest.mark.parametrize("source", ["frames", "frames+unix://relative.sock", "tcp://127.0.0.1:1", ""])
def test_a_source_of_no_known_kind_is_refused(source: str) -> None:
    with pytest.raises(ValueError, match=r"neither .oak. nor frames\+unix"):
        OakConfig(source=source)
