"""How each protocol is cut into messages, and which of them answer which: what a player matches by."""

import json
import re
import struct
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cell.wire_recording.reader import Connection
from fakes.wire.crc import crc16

Message = bytes


class Cutter:
    """Whole messages of a stream; ``length(data)`` is that of the first one, None while it is not known."""

    def __init__(self, length: Callable[[bytes], int | None]) -> None:
        self._length, self._rest = length, b""

    def feed(self, data: bytes) -> list[Message]:
        """What is complete with ``data``."""
        self._rest += data
        found = []
        while (size := self._length(self._rest)) is not None and len(self._rest) >= size:
            found.append(self._rest[:size])
            self._rest = self._rest[size:]
        return found


def up_to(*ends: bytes) -> Callable[[bytes], int | None]:
    """Text whose messages end with one of these bytes."""

    def length(data: bytes) -> int | None:
        places = [at for end in ends if (at := data.find(end)) >= 0]
        return min(places) + 1 if places else None

    return length


def prefixed(layout: str, header: int, more: int) -> Callable[[bytes], int | None]:
    """Binary messages: the last field of ``layout`` is the length, which does not count ``more`` bytes."""
    head = struct.Struct(layout)

    def length(data: bytes) -> int | None:
        return None if len(data) < header else int(head.unpack_from(data)[-1]) + more

    return length


# What a driver says, cut into messages, where answers simply come one after the other.
IN_TURN: dict[str, Callable[[bytes], int | None]] = {
    "rtde": prefixed(">H", 2, 0),
    "primary": up_to(b"\n"),
    "dashboard": up_to(b"\n"),
    "script": up_to(b"\n"),
    "tracker": up_to(b"\n", b"\r"),
    "slcan": up_to(b"\r"),
    "robotiq-urcap": up_to(b"\n"),
    "socketcand": up_to(b">"),
}


@dataclass(frozen=True)
class Dialect:
    """A protocol whose answers belong to a question, by its number or as the next thing that is said.

    ``length`` cuts what a driver says, ``heard`` what it hears. ``asks`` and ``answers`` give the number of a
    question or an answer, None for what is neither; ``key`` is what makes two questions the same one, asked
    again; ``answering`` is the answer with another number, ``files`` the files that it names and where the
    question wants them; ``reads`` tells keys of what is asked again and again, as the answer says what was
    true then.
    """

    length: Callable[[bytes], int | None]
    heard: Callable[[bytes], int | None]
    asks: Callable[[Message], Hashable | None]
    answers: Callable[[Message], Hashable | None]
    key: Callable[[Message], Hashable]
    answering: Callable[[Message, Message], Message]
    reads: Callable[[Hashable], bool] = lambda key: False
    files: Callable[[Message, Message], Sequence[tuple[Path, Path]]] = lambda answer, question: ()


def _motion(message: Message) -> dict[str, Any]:
    return dict(json.loads(message[4:]))


def _packed(layout: str, value: dict[str, Any]) -> Message:
    body = json.dumps(value, separators=(",", ":")).encode()
    return struct.pack(layout, len(body)) + body


_PICTURES = ("colour_file", "depth_file")


def _vision_answering(answer: Message, question: Message) -> Message:
    """The pictures of a capture lie where they were asked for this time."""
    said, asked = _motion(answer), _motion(question)
    said["id"] = asked["id"]
    for frame in said.get("frames", ()):
        for name in _PICTURES:
            if frame.get(name) and "folder" in asked:
                frame[name] = f"{asked['folder']}/{Path(frame[name]).name}"
    return _packed("<I", said)


def _vision_files(answer: Message, question: Message) -> list[tuple[Path, Path]]:
    """The pictures of a capture."""
    asked = _motion(question)
    if "folder" not in asked:
        return []
    frames = _motion(answer).get("frames", ())
    pictures = [Path(frame[name]) for frame in frames for name in _PICTURES if frame.get(name)]
    return [(picture, Path(asked["folder"]) / picture.name) for picture in pictures]


def rtu_request(data: bytes) -> int | None:
    """Modbus RTU: unit, function, what belongs to it, check sum."""
    if len(data) < 2:
        return None
    match data[1]:
        case 15 | 16:
            return 9 + data[6] if len(data) > 6 else None
        case 43:
            return 7
    return 8


def rtu_reply(data: bytes) -> int | None:
    """Modbus RTU, as :func:`rtu_request`; function 43 lists objects, each with a length of its own."""
    if len(data) < 3:
        return None
    function = data[1]
    if function & 0x80:
        return 5
    if function in (5, 6, 15, 16):
        return 8
    if function != 43:
        return 5 + data[2]
    at = 8
    for _ in range(data[7] if len(data) > 7 else 1):
        if len(data) < at + 2:
            return None
        at += 2 + data[at + 1]
    return at + 2


_MODBUS_READS = (1, 2, 3, 4)  # functions: coils, inputs, registers of both kinds

# A reply on a serial line belongs to the request before it: all have the same number.
_RTU = Dialect(
    length=rtu_request,
    heard=rtu_reply,
    asks=lambda message: 0,
    answers=lambda message: 0,
    key=lambda message: message,
    answering=lambda answer, question: answer,
)


_QUESTION = re.compile(rb"%R1Q,(\d+),(\d+)(?:,\d+)?:(.*?)\s*", re.DOTALL)
_ANSWER = re.compile(rb"%R1P,(\d+),(\d+)(,\d+)?(:.*?)\s*", re.DOTALL)
_READS = (b"2082", b"2107", b"2108", b"2167", b"6021")  # points, angles, lock


def _geocom_asks(message: Message) -> bytes | None:
    found = _QUESTION.fullmatch(message)
    return found[2] if found else None


def _geocom_answers(message: Message) -> bytes | None:
    """A request that the instrument could not read is answered with number 0: that comes at its time."""
    found = _ANSWER.fullmatch(message)
    return found[2] if found and int(found[2]) else None


def _geocom_key(message: Message) -> Hashable:
    """The procedure, with what is asked of it; but without places, which may differ by rounding."""
    found = _QUESTION.fullmatch(message)
    return found and (found[1], b"" if b"." in found[3] else found[3])


def _geocom_answering(answer: Message, question: Message) -> Message:
    said, number = _ANSWER.fullmatch(answer), _geocom_asks(question)
    if said is None or number is None:
        return answer
    head = b"%%R1P,%b,%b" % (said[1], number)
    check = b",%d" % crc16(head + said[4], 0) if said[3] else b""
    return head + check + said[4] + b"\r\n"


# Polls of a driver come between what a job asks: in a replay perhaps one more or less of them.
_GEOCOM = Dialect(
    length=up_to(b"\n", b"\r"),
    heard=up_to(b"\n"),
    asks=_geocom_asks,
    answers=_geocom_answers,
    key=_geocom_key,
    answering=_geocom_answering,
    reads=lambda key: isinstance(key, tuple) and key[0] in _READS,
)


def dialect_of(connection: Connection) -> Dialect | None:
    """How questions and answers of a connection belong together; None: they come in turn."""
    protocol = connection.protocol
    if protocol == "tracker" and any(r.sent and b"%R1Q," in r.data for r in connection.records):
        return _GEOCOM
    return _RTU if protocol == "modbus" and connection.peer.startswith("rtu:") else BY_NUMBER.get(protocol)


BY_NUMBER: dict[str, Dialect] = {
    "modbus": Dialect(
        length=prefixed(">HHH", 6, 6),
        heard=prefixed(">HHH", 6, 6),
        asks=lambda message: message[:2],
        answers=lambda message: message[:2],
        key=lambda message: message[6:],
        answering=lambda answer, question: question[:2] + answer[2:],
        reads=lambda key: isinstance(key, bytes) and key[1] in _MODBUS_READS,
    ),
    "motion-child": Dialect(
        length=prefixed(">I", 4, 4),
        heard=prefixed(">I", 4, 4),
        asks=lambda message: _motion(message).get("id"),
        answers=lambda message: None if "event" in _motion(message) else _motion(message)["id"],
        key=lambda message: _motion(message)["do"],
        answering=lambda answer, question: _packed(">I", _motion(answer) | {"id": _motion(question)["id"]}),
    ),
    "vision-child": Dialect(
        length=prefixed("<I", 4, 4),
        heard=prefixed("<I", 4, 4),
        asks=lambda message: _motion(message).get("id"),
        answers=lambda message: _motion(message)["id"] if _motion(message)["type"] == "answer" else None,
        key=lambda message: _motion(message)["type"],
        answering=_vision_answering,
        files=_vision_files,
    ),
}
