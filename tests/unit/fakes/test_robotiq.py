"""The twin's Robotiq gripper against the worked examples of the maker's manual, and fingers on a thing.

The frames are those of Robotiq's 2F-85/2F-140 manual, section "Modbus RTU example", byte for byte.
"""

from dataclasses import dataclass, field

import pytest

from drivers.grippers.robotiq_words import (
    READ,
    WRITTEN,
    Fingers,
    RobotiqState,
    activate_words,
    move_words,
)
from fakes.modbus_io.pdu import respond
from fakes.modbus_io.rtu import frame, parse
from fakes.robotiq.hand import Hand
from fakes.robotiq.registers import RobotiqTables

UNIT = 9
CLEAR, CLEARED = "09 10 03 E8 00 03 06 00 00 00 00 00 00 73 30", "09 10 03 E8 00 03 01 30"
ACTIVATE = "09 10 03 E8 00 03 06 01 00 00 00 00 00 72 E1"
STATUS, ACTIVATING, ACTIVE = "09 03 07 D0 00 01 85 CF", "09 03 02 11 00 55 D5", "09 03 02 31 00 4C 15"
CLOSE = "09 10 03 E8 00 03 06 09 00 00 FF FF FF 42 29"
OPEN = "09 10 03 E8 00 03 06 09 00 00 00 FF FF 72 19"
ALL_OF_IT = "09 03 07 D0 00 03 04 0E"
CLOSING, GRIPPED = "09 03 06 39 00 00 FF 0E 0A F7 8B", "09 03 06 B9 00 00 FF BD 00 1D 7C"


@dataclass
class Stage:
    """Time by hand, and fingers that take what is there 0.3 s after they are told to close."""

    t: float = 100.0
    there: bool = True
    commands: list[tuple[float, bool]] = field(default_factory=list)

    def command(self, t: float, close: bool) -> None:
        self.commands.append((t, close))

    def holds(self, t: float) -> object | None:
        closed = bool(self.commands) and self.commands[-1][1] and t >= self.commands[-1][0] + 0.3
        return 1 if closed and self.there else None


class Line:
    """A gripper on a serial line, without the line."""

    def __init__(self, stage: Stage) -> None:
        self.stage = stage
        self.tables = RobotiqTables(Hand(stage, 0.3, lambda: stage.t))

    def ask(self, request: str) -> str:
        parsed = parse(bytes.fromhex(request))
        assert parsed is not None, "the CRC of the manual is not ours"
        unit, pdu = parsed
        return frame(unit, respond(self.tables, pdu)).hex(" ").upper()

    def state(self) -> RobotiqState:
        words = self.tables.input()
        return RobotiqState.from_registers([words[READ + k] for k in range(3)])

    def activated(self) -> "Line":
        self.ask(CLEAR)
        self.ask(ACTIVATE)
        self.stage.t += 2.0
        return self


def test_activation_is_answered_as_in_the_manual() -> None:
    subject = Line(Stage())
    assert subject.ask(CLEAR) == CLEARED
    assert subject.ask(ACTIVATE) == CLEARED
    assert subject.ask(STATUS) == ACTIVATING
    subject.stage.t += 2.0
    assert subject.ask(STATUS) == ACTIVE


def test_closing_is_answered_as_in_the_manual_but_for_position_and_current() -> None:
    subject = Line(Stage()).activated()
    assert subject.ask(CLOSE) == CLEARED
    subject.stage.t += 0.02
    position_and_current = slice(21, 26)
    for manual in (CLOSING, GRIPPED):
        said = subject.ask(ALL_OF_IT)
        assert said[:20] == manual[:20]
        assert said[position_and_current] != "00 00"
        subject.stage.t += 1.0


def test_what_the_driver_writes_and_reads_is_what_the_manual_has() -> None:
    """Requests and answers of the manual, against the driver's numbers alone."""

    def write(words: list[int]) -> str:
        body = b"".join(word.to_bytes(2, "big") for word in words)
        return frame(UNIT, b"\x10" + WRITTEN.to_bytes(2, "big") + b"\x00\x03\x06" + body).hex(" ").upper()

    assert write(activate_words(False)) == CLEAR
    assert write(activate_words(True)) == ACTIVATE
    assert write(move_words(255, 255, 255)) == CLOSE
    assert write(move_words(0, 255, 255)) == OPEN

    def read(answer: str) -> RobotiqState:
        body = bytes.fromhex(answer)[3:-2]
        return RobotiqState.from_registers([int.from_bytes(body[k : k + 2]) for k in (0, 2, 4)])

    assert read(CLOSING) == RobotiqState(3, Fingers.MOVING, 0, 0xFF, 0x0E)
    assert read(GRIPPED) == RobotiqState(3, Fingers.BLOCKED_CLOSING, 0, 0xFF, 0xBD)


def test_fingers_that_meet_nothing_arrive() -> None:
    subject = Line(Stage(there=False)).activated()
    subject.ask(CLOSE)
    subject.stage.t += 0.31
    assert subject.state().fingers is Fingers.MOVING
    subject.stage.t += 0.1
    assert subject.state().fingers is Fingers.ARRIVED
    assert subject.state().position == 255


def test_a_thing_that_is_taken_out_lets_the_fingers_go_on() -> None:
    subject = Line(Stage()).activated()
    subject.ask(CLOSE)
    subject.stage.t += 1.0
    assert subject.state().fingers is Fingers.BLOCKED_CLOSING
    subject.stage.there = False
    assert subject.state().fingers is not Fingers.BLOCKED_CLOSING
    subject.ask(OPEN)
    subject.stage.t += 1.0
    assert (subject.state().fingers, subject.state().position) == (Fingers.ARRIVED, 0)
    assert [close for _, close in subject.stage.commands] == [True, False]


def test_without_activation_nothing_moves_and_the_fault_says_so() -> None:
    subject = Line(Stage())
    subject.ask(CLOSE)  # activates, and cannot go yet
    assert subject.stage.commands == []
    subject.ask(CLEAR)
    assert subject.state() == RobotiqState(0, Fingers.MOVING, 0, 0, 0)


@pytest.mark.parametrize("request_", ["09 02 00 00 00 01 B8 82", "09 03 07 D5 00 01 95 CE"])
def test_what_it_does_not_have_is_refused(request_: str) -> None:
    body = bytes.fromhex(request_)[:-2]
    reply = respond(Line(Stage()).tables, body[1:])
    assert reply[0] & 0x80
