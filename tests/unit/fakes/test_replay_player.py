"""A player of recordings: what comes when, what belongs to which question, and what it does not know."""

import asyncio
import json
import socket
import struct
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest

from cell.errors import CellError
from cell.wire_recording.reader import Connection, Record, WireRecording
from drivers.oak.protocol import pack
from drivers.tracker.geocom_text import crc16, parse_reply, request
from drivers.ur import rtde
from drivers.ur.dashboard import Dashboard
from drivers.ur.framing import encode
from fakes.object import VirtualClock
from fakes.object.loop import run_virtual
from fakes.replay.dialects import BY_NUMBER, IN_TURN, Cutter
from fakes.replay.player import ByNumber, WirePlayer, _Schedule

HOST, BEGIN = "127.0.23.1", 500.0


def recorded(protocol: str, peer: str, *said: tuple[float, bool, bytes]) -> Connection:
    records = [Record(BEGIN + t, sent, data) for t, sent, data in said]
    return Connection(protocol, peer, BEGIN, None, records)


DASHBOARD = recorded(
    "dashboard",
    f"{HOST}:29999",
    (0.1, False, b"Connected: Universal Robots Dashboard Server\n"),
    (0.2, True, b"running\n"),
    (0.5, False, b"Program running: false\n"),
)


def modbus(number: int, body: bytes) -> bytes:
    return struct.pack(">HHH", number, 0, len(body)) + body


def played(work: Callable[[WirePlayer, VirtualClock], Awaitable[Any]], *connections: Connection) -> Any:
    async def run() -> Any:
        clock = VirtualClock(BEGIN)
        async with WirePlayer(WireRecording(list(connections), []), clock) as player:
            return await work(player, clock)

    return run_virtual(run(), 60.0)


@pytest.mark.wire
def test_an_answer_comes_when_it_came_also_to_a_driver_that_asks_earlier() -> None:
    async def work(player: WirePlayer, clock: VirtualClock) -> tuple[float, float, str]:
        link = await Dashboard.connect(HOST, 1.0)
        greeted = clock.now()
        answer = await link.ask("running", 2.0)
        answered = clock.now()
        link.close()
        return greeted, answered, answer

    greeted, answered, answer = played(work, DASHBOARD)
    assert (greeted, answered) == (pytest.approx(BEGIN + 0.1, abs=1e-6), pytest.approx(BEGIN + 0.5, abs=1e-6))
    assert answer == "Program running: false"


@pytest.mark.wire
def test_a_question_that_was_never_asked_has_no_answer() -> None:
    async def work(player: WirePlayer, clock: VirtualClock) -> None:
        link = await Dashboard.connect(HOST, 1.0)
        await link.ask("running", 2.0)
        with pytest.raises(CellError, match="after 1 s"):
            await link.ask("is in remote control", 1.0)

    played(work, DASHBOARD)


def test_an_answer_by_number_goes_to_the_same_question_with_another_number() -> None:
    first, second = b"\x01\x04\x00\x10\x00\x01", b"\x01\x02\x00\x00\x00\x01"
    connection = recorded(
        "modbus",
        "child",
        *((0.0, True, modbus(7, first)), (0.1, False, modbus(7, b"\x01\x04\x02\x00\x2a"))),
        *((0.2, True, modbus(8, second)), (0.3, False, modbus(8, b"\x01\x02\x01\x01"))),
    )

    found = heard(connection, (0.0, modbus(1, second)), (0.0, modbus(2, first)))
    assert [answer for _, answer in found] == [
        modbus(1, b"\x01\x02\x01\x01"),
        modbus(2, b"\x01\x04\x02\x00\x2a"),
    ]


def station(number: int, said: str) -> bytes:
    return f"%R1P,0,{number}:0,{said}\r\n".encode()


STATION = recorded(
    "tracker",
    "child",
    *((0.0, True, b"\n%R1Q,6021,1:\r\n"), (0.1, False, station(1, "0"))),
    *((1.0, True, b"%R1Q,2024,2:0.0\r\n"), (1.1, False, station(2, "7"))),
    *((2.0, True, b"%R1Q,6021,3:\r\n"), (2.1, False, station(3, "1"))),
    *((3.0, True, b"%R1Q,6021,4:\r\n"), (3.1, False, station(4, "2"))),
)


def heard(connection: Connection, *questions: tuple[float, bytes]) -> list[tuple[float, bytes]]:
    """What comes to questions that are asked at these times, and when, s after the beginning."""

    class Pipe(WirePlayer):
        async def __aenter__(self) -> "Pipe":
            return self

    async def run() -> list[tuple[float, bytes]]:
        clock, found = VirtualClock(BEGIN), list[tuple[float, bytes]]()
        async with Pipe(WireRecording([connection], []), clock) as player:
            ours, theirs = socket.socketpair()
            ours.setblocking(False)
            await player.pipe(theirs, connection.protocol, connection.peer)
            loop = asyncio.get_running_loop()
            for t, question in questions:
                await clock.sleep(max(BEGIN + t - clock.now(), 0.0))
                await loop.sock_sendall(ours, question)
                answer = await loop.sock_recv(ours, 100)
                found.append((clock.now() - BEGIN, answer))
            ours.close()
        return found

    return run_virtual(run(), 60.0)


def test_a_station_answers_the_question_that_is_asked_and_not_the_one_that_came_next() -> None:
    """A job asks a little earlier than it did, and the poll before it is left out."""
    found = heard(STATION, (0.5, b"%R1Q,2024,1:0.0000001\r\n"), (1.5, b"%R1Q,6021,2:\r\n"))
    assert [answer for _, answer in found] == [station(1, "7"), station(2, "0")]
    assert [t for t, _ in found] == pytest.approx([1.1, 1.5], abs=1e-6)


def test_what_a_station_told_while_nobody_asked_is_not_told_later() -> None:
    found = heard(STATION, (2.5, b"%R1Q,6021,1:\r\n"), (3.0, b"%R1Q,6021,2:\r\n"))
    assert [answer for _, answer in found] == [station(1, "1"), station(2, "2")]
    assert [t for t, _ in found] == pytest.approx([2.5, 3.1], abs=1e-6)


def reading(number: int, address: int, value: int | None = None) -> bytes:
    """A request for one holding register, or its reply."""
    if value is None:
        return modbus(number, struct.pack(">BBHH", 1, 3, address, 1))
    return modbus(number, struct.pack(">BBBH", 1, 3, 2, value))


# In the second poll of four an answer came late, and the replay gives that poll up.
POLLED = recorded(
    "modbus",
    "child",
    *((0.000, True, modbus(1, b"\1\x2b\x0e\1\0")), (0.002, False, modbus(1, b"\1\x2b\x0e"))),
    *((1.000, True, reading(2, 10)), (1.002, False, reading(2, 10, 1))),
    *((1.003, True, reading(3, 20)), (1.005, False, reading(3, 20, 1))),
    *((1.050, True, reading(4, 10)), (1.300, False, reading(4, 10, 2))),
    *((1.301, True, reading(9, 20)), (1.303, False, reading(9, 20, 2))),
    *((1.350, True, reading(5, 10)), (1.352, False, reading(5, 10, 3))),
    *((1.353, True, reading(6, 20)), (1.355, False, reading(6, 20, 3))),
    *((1.400, True, reading(7, 10)), (1.402, False, reading(7, 10, 4))),
    *((1.403, True, reading(8, 20)), (1.405, False, reading(8, 20, 4))),
)


def test_a_poll_begins_at_the_first_of_its_questions() -> None:
    playback = ByNumber(POLLED, BY_NUMBER["modbus"], bytearray().extend, _Schedule(VirtualClock(BEGIN)))
    assert [t - BEGIN for t in playback.polls] == pytest.approx([1.0, 1.05, 1.35, 1.4])


def test_a_reading_that_nobody_asked_for_does_not_make_each_later_one_older() -> None:
    """The driver asks the second question of each poll 1 ms earlier than it did."""
    asked = [(0.0, modbus(1, b"\1\x2b\x0e\1\0")), (1.0, reading(2, 10)), (1.002, reading(3, 20))]
    asked += [(1.35, reading(4, 10)), (1.352, reading(5, 20)), (1.4, reading(6, 10)), (1.402, reading(7, 20))]
    found = [(t, answer[-1]) for t, answer in heard(POLLED, *asked)][1:]
    assert [value for _, value in found] == [1, 1, 3, 3, 4, 4]
    times = [1.002, 1.005, 1.352, 1.355, 1.402, 1.405]
    assert [t for t, _ in found] == pytest.approx(times, abs=1e-6)


def test_a_stations_answer_with_another_number_has_another_check_sum() -> None:
    def checked(kind: str, numbers: str, rest: str) -> bytes:
        return f"%R1{kind},{numbers},{crc16(f'%R1{kind},{numbers}{rest}'.encode())}{rest}\r\n".encode()

    one = recorded(
        "tracker",
        "child",
        (0.0, True, checked("Q", "6021,9", ":")),
        (0.1, False, checked("P", "0,9", ":0,1")),
    )
    ((_, answer),) = heard(one, (0.0, request(6021, 4, checksum=True)))
    assert parse_reply(answer.strip(), checksum=True).transaction == 4


def test_streams_are_cut_where_the_drivers_own_messages_end() -> None:
    """The drivers' encoders are the other side of these cutters."""
    for length, messages in (
        (IN_TURN["rtde"], [rtde.request_version(), rtde.request_inputs(["a", "b"])]),
        (IN_TURN["socketcand"], [b"< open can0 >", b"< rawmode >"]),
        (BY_NUMBER["motion-child"].length, [encode({"id": 1, "do": "open"}), encode({"beat": 1.5})]),
        (BY_NUMBER["vision-child"].length, [pack({"type": "target", "id": 3}), pack({"type": "items"})]),
    ):
        stream = b"".join(messages)
        subject, found = Cutter(length), []
        for at in range(0, len(stream), 3):
            found += subject.feed(stream[at : at + 3])
        assert found == messages


@pytest.mark.parametrize("folder", ["old", "new"])
def test_the_pictures_of_a_capture_are_copied_where_the_run_still_has_them(
    tmp_path: Path, folder: str
) -> None:
    """Into the very folder of the recording, too."""
    old, new = tmp_path / "old", tmp_path / folder
    old.mkdir()
    new.mkdir(exist_ok=True)
    (old / "p1-depth.png").write_bytes(b"depth")
    pictures = [{"colour_file": f"{old}/gone.png", "depth_file": f"{old}/p1-depth.png"}]
    asked = {"type": "capture", "id": 2, "folder": str(old)}
    said = {"type": "answer", "id": 2, "frames": pictures}
    recording = recorded("vision-child", "camera", (0.1, True, pack(asked)), (0.2, False, pack(said)))

    async def work(player: WirePlayer, clock: VirtualClock) -> bytes:
        ours, theirs = socket.socketpair()
        ours.setblocking(False)
        await player.pipe(theirs, "vision-child", "camera")
        with ours:
            loop = asyncio.get_running_loop()
            await loop.sock_sendall(ours, pack(asked | {"folder": str(new)}))
            return await loop.sock_recv(ours, 65536)

    answer = json.loads(played(work, recording)[4:])
    assert answer["frames"][0]["depth_file"] == f"{new}/p1-depth.png"
    assert [file.name for file in new.iterdir()] == ["p1-depth.png"]
    assert (new / "p1-depth.png").read_bytes() == b"depth"


def test_the_pictures_of_a_capture_are_where_they_are_asked_for() -> None:
    said = {"type": "answer", "id": 9, "frames": [{"colour_file": "/old/run/p1_0.png", "depth_file": None}]}
    asked = {"type": "capture", "id": 2, "folder": "/new"}
    answer = BY_NUMBER["vision-child"].answering(pack(said), pack(asked))
    assert json.loads(answer[4:]) == said | {
        "id": 2,
        "frames": [{"colour_file": "/new/p1_0.png", "depth_file": None}],
    }
