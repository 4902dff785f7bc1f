"""The fake input module on its serial line, byte by byte: frames, silences, noise and faults."""

import asyncio
import os
import termios
import tty
from collections.abc import Awaitable, Callable
from contextlib import suppress
from pathlib import Path

import pytest

from fakes.modbus_io import rtu
from tests.kit.modbus_io_rig import Rig, rig

pytestmark = pytest.mark.wire
LEVELS, ANSWER = rtu.frame(17, bytes.fromhex("0200000003")), rtu.frame(17, bytes.fromhex("020105"))
COUNTER, CLEAR = bytes.fromhex("0400000002"), bytes.fromhex("050000ff00")


class Line:
    """The master's end of the line."""

    def __init__(self, path: Path, baud: int = termios.B115200) -> None:
        self._descriptor = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        tty.setraw(self._descriptor)
        settings = termios.tcgetattr(self._descriptor)
        settings[4] = settings[5] = baud
        termios.tcsetattr(self._descriptor, termios.TCSANOW, settings)

    def put(self, data: bytes) -> None:
        os.write(self._descriptor, data)

    async def heard(self, size: int = 0) -> bytes:
        """What comes: at least ``size`` bytes, or everything of the next 50 ms."""
        got, turns = b"", 10 if size == 0 else 400
        for _ in range(turns):
            await asyncio.sleep(0.005)
            with suppress(BlockingIOError):
                got += os.read(self._descriptor, 8192)
            if 0 < size <= len(got):
                break
        return got

    async def answers(self, frame: bytes, answer: bytes) -> bool:
        """Whether ``frame`` is answered with ``answer``; with nothing for an empty one."""
        self.put(frame)
        return await self.heard(len(answer)) == answer

    def close(self) -> None:
        os.close(self._descriptor)


def talk(folder: Path, script: Callable[[Rig, Line], Awaitable[None]], baud: int = termios.B115200) -> None:
    async def scene() -> None:
        path = folder / "io.tty"
        async with rig(line=path) as subject:
            line = Line(path, baud)
            try:
                assert await line.answers(LEVELS, ANSWER)
                await script(subject, line)
            finally:
                line.close()
        assert not path.is_symlink()

    asyncio.run(scene())


def test_noise_and_frames_with_a_bad_crc_are_ignored_and_the_next_frame_is_answered(tmp_path: Path) -> None:
    async def script(subject: Rig, line: Line) -> None:
        for noise in (b"\xff" * 50, LEVELS[:-1] + b"\0", LEVELS[:5], b"\0", bytes(range(256)) * 8):
            assert await line.answers(noise, b"")
            assert await line.answers(LEVELS, ANSWER)

    talk(tmp_path, script)


def test_two_frames_without_a_silence_between_them_are_no_frame(tmp_path: Path) -> None:
    async def script(subject: Rig, line: Line) -> None:
        assert await line.answers(LEVELS + LEVELS, b"")

    talk(tmp_path, script)


def test_a_slow_line_may_pause_within_a_frame_and_a_fast_one_may_not(tmp_path: Path) -> None:
    async def halves(subject: Rig, line: Line) -> None:
        line.put(LEVELS[:4])
        await asyncio.sleep(0.015)
        answered.append(await line.answers(LEVELS[4:], ANSWER if slow else b""))

    answered: list[bool] = []
    slow = True
    talk(tmp_path, halves, termios.B300)  # 3.5 characters are 128 ms
    slow = False
    talk(tmp_path, halves, termios.B115200)
    assert answered == [True, True]


def test_a_broadcast_is_done_and_not_answered(tmp_path: Path) -> None:
    async def script(subject: Rig, line: Line) -> None:
        assert await line.answers(rtu.frame(1, COUNTER), rtu.frame(1, bytes.fromhex("040400011170")))
        assert await line.answers(rtu.frame(0, CLEAR), b"")
        assert await line.answers(rtu.frame(1, COUNTER), rtu.frame(1, bytes.fromhex("040400000000")))

    talk(tmp_path, script)


def test_replies_that_nobody_reads_do_not_stop_the_module(tmp_path: Path) -> None:
    async def script(subject: Rig, line: Line) -> None:
        subject.inject("junk")
        for _ in range(40):
            subject.wires.junk(bytes(4096))
        assert len(await line.heard()) > 4000
        while await line.heard():
            pass
        assert await line.answers(LEVELS, ANSWER)

    talk(tmp_path, script)


@pytest.mark.parametrize(
    ("fault", "answer"),
    [("silence", b""), ("half-open", b""), ("duplicate", ANSWER * 2), ("split", ANSWER), ("drop", ANSWER)],
)
def test_faults_of_the_wires_show_on_the_line_where_they_can(
    tmp_path: Path, fault: str, answer: bytes
) -> None:
    async def script(subject: Rig, line: Line) -> None:
        subject.inject(fault)
        assert await line.answers(LEVELS, answer)
        subject.inject("clear")
        assert await line.answers(LEVELS, ANSWER)

    talk(tmp_path, script)


def test_a_delay_holds_back_the_reply(tmp_path: Path) -> None:
    async def script(subject: Rig, line: Line) -> None:
        subject.inject("delay", s=0.15)
        assert await line.answers(LEVELS, b"")
        assert await line.heard(len(ANSWER)) == ANSWER

    talk(tmp_path, script)


def test_a_module_that_reboots_says_nothing_and_has_counters_at_zero_afterwards(tmp_path: Path) -> None:
    async def script(subject: Rig, line: Line) -> None:
        line.put(LEVELS)
        subject.inject("reboot", boot_s=0.2)
        assert await line.heard() == b""
        assert await line.answers(LEVELS, b"")
        await asyncio.sleep(0.2)
        assert await line.answers(rtu.frame(1, COUNTER), rtu.frame(1, bytes.fromhex("040400000000")))

    talk(tmp_path, script)
