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
from drivers.ur import rtde
from drivers.ur.dashboard import Dashboard
from drivers.ur.framing import encode
from fakes.object import VirtualClock
from fakes.object.loop import run_virtual
from fakes.replay.dialects import BY_NUMBER, IN_TURN, Cutter
from fakes.replay.player import WirePlayer

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

    async def work(player: WirePlayer, clock: VirtualClock) -> list[bytes]:
        ours, theirs = socket.socketpair()
        ours.setblocking(False)
        await player.pipe(theirs, "modbus", "child")
        loop, found = asyncio.get_running_loop(), []
        for request in (modbus(1, second), modbus(2, first)):
            await loop.sock_sendall(ours, request)
            found.append(await loop.sock_recv(ours, 100))
        ours.close()
        return found

    class Pipe(WirePlayer):
        async def __aenter__(self) -> "Pipe":
            return self

    async def run() -> list[bytes]:
        async with Pipe(WireRecording([connection], []), VirtualClock(BEGIN)) as player:
            return await work(player, VirtualClock(BEGIN))

    assert run_virtual(run(), 10.0) == [modbus(1, b"\x01\x02\x01\x01"), modbus(2, b"\x01\x04\x02\x00\x2a")]


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


def test_the_pictures_of_a_capture_are_copied_where_the_run_still_has_them(tmp_path: Path) -> None:
    old, new = tmp_path / "old", tmp_path / "new"
    old.mkdir()
    new.mkdir()
    (old / "p1-depth.png").write_bytes(b"depth")
    said = {"type": "answer", "id": 9, "frames": [{"colour_file": None, "depth_file": f"{old}/p1-depth.png"}]}
    BY_NUMBER["vision-child"].answering(pack(said), pack({"type": "capture", "id": 2, "folder": str(new)}))
    assert (new / "p1-depth.png").read_bytes() == b"depth"


def test_the_pictures_of_a_capture_are_where_they_are_asked_for() -> None:
    said = {"type": "answer", "id": 9, "frames": [{"colour_file": "/old/run/p1_0.png", "depth_file": None}]}
    asked = {"type": "capture", "id": 2, "folder": "/new"}
    answer = BY_NUMBER["vision-child"].answering(pack(said), pack(asked))
    assert json.loads(answer[4:]) == said | {
        "id": 2,
        "frames": [{"colour_file": "/new/p1_0.png", "depth_file": None}],
    }
