"""The frame server's timing, losses and faults, over a real socket but without a child."""

import itertools
import json
import socket
import struct
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from cell.errors import CellError
from fakes.faults.vocabulary import Fault
from fakes.frames.faults import CameraFaults
from fakes.frames.rack_view import RackView
from fakes.frames.server import FrameServer
from fakes.world.scenario import Scenario
from fakes.world.world import World

pytestmark = pytest.mark.wire
PERIOD_S = 0.02


class Reader:
    """An independent reader of the frame stream."""

    def __init__(self, path: Path) -> None:
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self.socket.settimeout(5.0)
        self.socket.connect(str(path))
        self.file = self.socket.makefile("rb")

    def frame(self) -> tuple[dict[str, Any], bytes, bytes]:
        (length,) = struct.unpack("<I", self._exactly(4))
        if length > 65536:
            raise ValueError(f"a header of {length} bytes")
        header = json.loads(self._exactly(length))
        pixels = header["width"] * header["height"]
        return header, self._exactly(3 * pixels), self._exactly(2 * pixels)

    def _exactly(self, count: int) -> bytes:
        data = self.file.read(count)
        if len(data) < count:
            raise EOFError
        return data

    def close(self) -> None:
        self.file.close()
        self.socket.close()


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "frames.sock"


@pytest.fixture
def subject(path: Path) -> Iterator[FrameServer]:
    truth = Scenario.load("hand_eye:ideal").world
    small = {"width": 320, "height": 200, "K": [200.0, 200.0, 159.5, 99.5], "dist": []}
    timing = {"period_s": PERIOD_S, "latency_s": 0.015, "exposure_s": 0.004}
    camera = truth.camera.model_copy(update=small | timing)
    world = World(truth.model_copy(update={"camera": camera}), time.monotonic())
    server = FrameServer(world, str(path))
    thread = threading.Thread(target=server.run)
    thread.start()
    yield server
    server.stop()
    thread.join()
    server.close()


@pytest.fixture
def reader(subject: FrameServer, path: Path) -> Iterator[Reader]:
    reader = Reader(path)
    yield reader
    reader.close()


def test_a_frame_carries_what_the_format_says(reader: Reader) -> None:
    header, colour, depth = reader.frame()
    received = time.monotonic()
    assert set(header) == {
        *("seq", "t_exposure", "exposure_s", "width", "height", "K", "dist", "colour", "depth", "serial"),
        *("row_time_s", "lens_position"),
    }
    assert (header["colour"], header["depth"], header["exposure_s"]) == ("bgr8", "u16mm", 0.004)
    assert header["K"] == [200.0, 200.0, 159.5, 99.5]
    assert header["serial"].startswith("9999")
    assert len(colour) == 320 * 200 * 3
    assert len(depth) == 320 * 200 * 2
    assert 0.015 <= received - header["t_exposure"] < 2.0, "mid exposure on the monotonic clock"


def test_exposures_lie_on_a_grid_and_are_numbered_on_it(reader: Reader) -> None:
    headers = [reader.frame()[0] for _ in range(10)]
    steps = {b["seq"] - a["seq"] for a, b in itertools.pairwise(headers)}
    assert min(steps) >= 1
    for a, b in itertools.pairwise(headers):
        assert b["t_exposure"] - a["t_exposure"] == pytest.approx((b["seq"] - a["seq"]) * PERIOD_S, abs=1e-9)


def test_nothing_is_drawn_while_nobody_looks(subject: FrameServer, path: Path) -> None:
    time.sleep(5 * PERIOD_S)
    assert subject.exposures == 0
    reader = Reader(path)
    reader.frame()
    reader.close()
    time.sleep(0.5)
    drawn = subject.exposures
    time.sleep(5 * PERIOD_S)
    assert subject.exposures == drawn > 0


def test_a_slow_reader_loses_frames_and_then_gets_new_ones(reader: Reader) -> None:
    reader.frame()
    time.sleep(1.0)
    # What was in the socket's buffer and the one frame on its way are old; the next is not.
    in_flight = [reader.frame()[0] for _ in range(3)]
    header, *_ = reader.frame()
    assert header["seq"] - in_flight[0]["seq"] > 10, "frames were lost, and the numbers show it"
    assert time.monotonic() - header["t_exposure"] < 0.5, "no queue of old frames"


def test_a_slow_reader_does_not_slow_another(subject: FrameServer, reader: Reader, path: Path) -> None:
    reader.frame()
    quick = Reader(path)
    try:
        ages = []
        for _ in range(20):
            header = quick.frame()[0]
            ages.append(time.monotonic() - header["t_exposure"])
    finally:
        quick.close()
    assert sorted(ages)[10] < 0.2


def inject(server: FrameServer, fault: Fault, **arguments: Any) -> None:
    CameraFaults(server.handle).inject(fault, arguments)


def test_silence_keeps_the_connection_and_ends_when_cleared(subject: FrameServer, reader: Reader) -> None:
    reader.frame()
    inject(subject, Fault.SILENCE)
    time.sleep(0.2)
    before = subject.exposures
    time.sleep(0.2)
    assert subject.exposures == before
    CameraFaults(subject.handle).clear()
    first = reader.frame()[0]["seq"]
    assert max(reader.frame()[0]["seq"] for _ in range(4)) > first


def test_a_frozen_camera_repeats_its_last_frame(subject: FrameServer, reader: Reader) -> None:
    reader.frame()
    inject(subject, Fault.FREEZE)
    time.sleep(0.2)
    seen = [reader.frame()[0]["seq"] for _ in range(12)]
    assert len(set(seen[6:])) == 1


def test_a_dropped_connection_can_be_made_again(subject: FrameServer, reader: Reader, path: Path) -> None:
    reader.frame()
    inject(subject, Fault.DROP)
    with pytest.raises((EOFError, OSError)):
        for _ in range(50):
            reader.frame()
    again = Reader(path)
    assert again.frame()[0]["seq"] > 0
    again.close()


def test_a_refusing_server_ends_new_connections_too(subject: FrameServer, reader: Reader, path: Path) -> None:
    inject(subject, Fault.REFUSE)
    time.sleep(0.1)
    again = Reader(path)
    with pytest.raises((EOFError, OSError)):
        again.frame()
    again.close()


def test_junk_is_no_frame(subject: FrameServer, reader: Reader) -> None:
    reader.frame()
    inject(subject, Fault.JUNK)
    with pytest.raises((ValueError, EOFError, OSError)):
        for _ in range(50):
            reader.frame()


def test_a_rebooted_camera_may_be_another_one(subject: FrameServer, path: Path) -> None:
    inject(subject, Fault.REBOOT, serial="99992200777")
    time.sleep(0.2)
    reader = Reader(path)
    assert reader.frame()[0]["serial"] == "99992200777"
    reader.close()


def test_a_clock_jump_moves_the_stamps_only(subject: FrameServer, reader: Reader) -> None:
    inject(subject, Fault.CLOCK_JUMP, jump_s=100.0)
    stamps = [reader.frame()[0]["t_exposure"] for _ in range(5)]
    assert stamps[-1] > time.monotonic() + 99.0


def test_darkness_and_a_lost_board_show_in_the_picture(subject: FrameServer, reader: Reader) -> None:
    bright = reader.frame()[1]
    inject(subject, Fault.LOST_BOARD)
    inject(subject, Fault.DARK, gain=0.05)
    for _ in range(5):
        dark = reader.frame()[1]
    assert sum(dark) < 0.1 * sum(bright)


def test_a_bad_argument_is_refused_where_it_is_typed(subject: FrameServer) -> None:
    with pytest.raises(CellError) as caught:
        inject(subject, Fault.DELAY, delay_s="soon")
    assert caught.value.name == "ARGUMENT_INVALID"


def test_a_mirrored_world_shows_the_same_scene() -> None:
    scenario = Scenario.load("hand_eye:ideal")
    twin, mirror = World.from_scenario(scenario, 5.0), World.from_scenario(scenario, 5.5)
    twin.track.start_joint_move(6.0, twin.track.at(6.0)[0] + 0.2, 1.0, 2.0)
    twin.operator.move_on(6.5)
    twin.mirror_to(mirror.apply)
    twin.track.start_joint_move(9.0, twin.track.at(9.0)[0] - 0.1, 1.0, 2.0)
    twin.operator.remove(11.0)
    for t in (5.2, 6.1, 8.0, 9.2, 10.9):
        a, b = twin.scene(t), mirror.scene(t)
        assert a.T_camera_target is not None
        assert b.T_camera_target is not None
        assert (a.T_camera_target.as_matrix() == b.T_camera_target.as_matrix()).all()
    assert mirror.scene(11.5).T_camera_target is None


def test_a_rack_is_seen_where_no_board_stands_before_it(path: Path) -> None:
    scenario = Scenario.load("slot")
    small = {"width": 320, "height": 200, "K": [200.6, 200.4, 161.0, 99.2]}
    camera = scenario.world.camera.model_copy(update=small)
    world_config = scenario.world.model_copy(update={"camera": camera})
    subject = FrameServer(World(world_config, 0.0), str(path))
    try:
        with_board = subject._picture(1.0, 1, camera.exposure())
        subject.world.operator.remove(2.0)
        with_rack = subject._picture(3.0, 2, camera.exposure())
        assert subject.world.rack is not None
        expected = RackView(subject.world, subject.world.rack).picture(3.0, 2)
    finally:
        subject.close()
    assert (with_rack.colour == expected[0]).all()
    assert (with_rack.depth == expected[1]).all()
    assert (with_board.colour != with_rack.colour).mean() > 0.5
