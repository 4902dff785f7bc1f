"""Plays a recording: each connection that a driver makes gets what the same one got when it was recorded.

What a device said by itself comes at the time at which it came. An answer comes at its time too, but never
before its question, and belongs to the same question asked again. So drivers that ask at the same times get
the same, and drivers that ask a little earlier wait. A player does not understand a device: what was never
asked has no answer, which a driver meets as silence.
"""

import asyncio
import shutil
import socket
from collections import defaultdict, deque
from collections.abc import Callable, Hashable, Iterable
from contextlib import suppress
from dataclasses import replace
from math import inf
from pathlib import Path
from typing import NamedTuple, cast

from cell.clock import Clock
from cell.errors import error
from cell.wire_recording.reader import Connection, WireRecording
from fakes.replay.dialects import IN_TURN, Cutter, Dialect, dialect_of
from fakes.replay.serial_lines import PlayedLine, serial_line

Write = Callable[[bytes], None]
EARLY_S = 0.01  # a driver in virtual time computes at once, and may ask so much earlier than it did
_FRAME = b"< frame"  # what a gateway sends after its greeting


class _Schedule:
    """Calls at times of the recording; times that are over are now."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self.handles: set[asyncio.TimerHandle] = set()

    def at(self, t: float, call: Callable[[], None]) -> None:
        """Call at ``t`` s of the clock, which runs like that of the recording."""
        loop = asyncio.get_running_loop()

        def run() -> None:
            self.handles.discard(handle)
            call()

        handle = loop.call_later(max(t - self._clock.now(), 0.0), run)
        self.handles.add(handle)

    def due(self, t: float) -> bool:
        return self._clock.now() >= t


class InTurn:
    """A connection whose answers come one after the other, among what comes by itself."""

    def __init__(self, connection: Connection, write: Write, schedule: _Schedule) -> None:
        self._records, self._write, self._schedule = deque(connection.records), write, schedule
        self._length = IN_TURN[connection.protocol]
        self._heard = Cutter(self._length)
        self._credit = 0  # messages that were said and not yet expected
        self._waits = False
        # A thread of the driver waits for the gateway's greeting, and a virtual clock stands still meanwhile.
        self._greeting = connection.protocol == "socketcand"

    def begin(self) -> None:
        """The driver has connected."""
        self._go_on()

    def received(self, data: bytes) -> None:
        """The driver says something."""
        self._credit += len(self._heard.feed(data))
        self._go_on()

    def _go_on(self) -> None:
        while self._records and not self._waits:
            record = self._records[0]
            if record.sent:
                expected = len(Cutter(self._length).feed(record.data))
                if expected > self._credit:
                    return
                self._credit -= expected
            elif self._greeting or self._schedule.due(record.t):
                self._write(record.data)
                self._greeting = self._greeting and not record.data.startswith(_FRAME)
            else:
                self._waits = True
                self._schedule.at(record.t, self._waited)
                return
            self._records.popleft()

    def _waited(self) -> None:
        self._waits = False
        self._go_on()


class _Answer(NamedTuple):
    """What was said at ``t``, s, to what was asked at ``asked``."""

    asked: float
    t: float
    message: bytes


def _copy(files: Iterable[tuple[Path, Path]]) -> None:
    """Put files that an answer names where the question wants them, if they are still there."""
    for there, wanted in files:
        if there.exists() and not (wanted.exists() and wanted.samefile(there)):
            shutil.copyfile(there, wanted)


class ByNumber:
    """A connection whose answers belong to a question: by its number, or as the next thing that is said."""

    def __init__(self, connection: Connection, dialect: Dialect, write: Write, schedule: _Schedule) -> None:
        self._dialect, self._write, self._schedule = dialect, write, schedule
        self._heard = Cutter(self._dialect.length)
        self._answers: dict[Hashable, deque[_Answer]] = defaultdict(deque)
        self._by_itself: list[tuple[float, bytes]] = []
        self._asked: dict[Hashable, list[float]] = defaultdict(list)  # when each question was
        # On a serial line, which is played in real time, the driver may be late and yet asks for each.
        self._leaves_out = serial_line(connection.protocol, connection.peer) is None
        self._begun = False
        self._sort(connection)

    def begin(self) -> None:
        """Nothing is said before the driver has said something."""

    def received(self, data: bytes) -> None:
        """The driver says something."""
        if not self._begun:
            self._begun = True
            for t, message in self._by_itself:
                self._schedule.at(t, lambda message=message: self._write(message))  # type: ignore[misc]
        for question in self._heard.feed(data):
            waiting = self._waiting(question)
            if waiting:
                answer = waiting.popleft()
                reply = self._dialect.answering(answer.message, question)
                _copy(self._dialect.files(answer.message, question))
                self._schedule.at(answer.t, lambda reply=reply: self._write(reply))  # type: ignore[misc]

    def next_asked(self, question: bytes, after: float = -inf) -> float | None:
        """When the question was asked whose answer is the next one to this one, s; the first later than
        ``after``."""
        return next((answer.asked for answer in self._waiting(question) if answer.asked > after), None)

    @property
    def polls(self) -> deque[float]:
        """When the polls of a driver that asks the same in each began, s: at the first of its questions.

        Not at the others: a replay whose poll ended without an answer would go on in the middle of one, and
        have each reading a period late.
        """
        most = max((len(times) for times in self._asked.values()), default=0)
        of_each = [times for times in self._asked.values() if len(times) > 0.5 * most]
        return deque(min(of_each, default=[]))

    def _waiting(self, question: bytes) -> deque[_Answer]:
        """The answers to it that are left. What is read tells what is true now: in virtual time an answer is
        left out once the next one was asked for, or is about to be, nearer to now. Else each that is asked
        after one that nobody asked for would be older by so much."""
        dialect = self._dialect
        if dialect.asks(question) is None:
            return deque()
        key = dialect.key(question)
        waiting = self._answers.get(key, deque())
        if self._leaves_out and dialect.reads(key):
            while len(waiting) > 1:
                one, other = waiting[0].asked, waiting[1].asked
                if not self._schedule.due(max(0.5 * (one + other), other - EARLY_S)):
                    break
                waiting.popleft()
        return waiting

    def _sort(self, connection: Connection) -> None:
        dialect, keys = self._dialect, dict[Hashable, tuple[Hashable, float]]()
        said, heard = Cutter(dialect.length), Cutter(dialect.heard)
        for record in connection.records:
            if record.sent:
                for message in said.feed(record.data):
                    if (number := dialect.asks(message)) is not None:
                        key = dialect.key(message)
                        keys[number] = key, record.t
                        self._asked[key].append(record.t)
                continue
            for message in heard.feed(record.data):
                answered = dialect.answers(message)
                if answered is None:
                    self._by_itself.append((record.t, message))
                elif answered in keys:
                    key, asked = keys.pop(answered)
                    self._answers[key].append(_Answer(asked, record.t, message))


Playback = InTurn | ByNumber


class WirePlayer:
    """``async with``: the TCP peers of a recording listen at their addresses, which must be free, and its
    serial lines are pseudo-terminals at their paths, or below the folder ``lines`` by their last names.

    ``clock`` runs like that of the recording; with serial lines it has to be that of the computer, as the
    kernel hands on what is written to one in its own time: see :func:`moved`. :meth:`pipe` stands in for a
    child process.
    """

    def __init__(self, recording: WireRecording, clock: Clock, lines: Path | None = None) -> None:
        self._folder, self._lines = lines, list[PlayedLine]()
        self._schedule = _Schedule(clock)
        self._waiting: dict[tuple[str, str], deque[Connection]] = defaultdict(deque)
        for connection in recording.connections:
            self._waiting[connection.protocol, connection.peer].append(connection)
        self.playing: list[tuple[Connection, Playback]] = []
        self._servers: list[asyncio.Server] = []
        self._transports: set[asyncio.Transport] = set()

    async def __aenter__(self) -> "WirePlayer":
        loop = asyncio.get_running_loop()
        try:
            for protocol, peer in self._waiting:
                if protocol.endswith("-child"):
                    continue
                if (line := serial_line(protocol, peer)) is not None:
                    self._open_line(line, (protocol, peer))
                    continue
                host, port = _place(peer)
                key = protocol, peer
                self._servers.append(await loop.create_server(lambda key=key: _Stand(self, key), host, port))  # type: ignore[misc]
        except BaseException:
            await self.__aexit__()
            raise
        return self

    async def __aexit__(self, *_: object) -> None:
        for handle in self._schedule.handles:
            handle.cancel()
        for line in self._lines:
            line.close()
        for transport in tuple(self._transports):
            transport.abort()
        for server in self._servers:
            server.close()
        await asyncio.sleep(0)

    def next_connection(self, key: tuple[str, str], transport: asyncio.Transport) -> Playback | None:
        """What to play to a driver that has connected now; None when it was never connected so often."""
        self._transports.add(transport)
        waiting = self._waiting[key]
        if not waiting:
            return None
        connection = waiting.popleft()
        dialect = dialect_of(connection)

        def write(data: bytes) -> None:
            with suppress(OSError):
                if not transport.is_closing():
                    transport.write(data)

        made: Playback = (
            InTurn(connection, write, self._schedule)
            if dialect is None
            else ByNumber(connection, dialect, write, self._schedule)
        )
        self.playing.append((connection, made))
        return made

    def forget(self, transport: asyncio.Transport) -> None:
        self._transports.discard(transport)

    def _open_line(self, line: Path, key: tuple[str, str]) -> None:
        place = line if self._folder is None else self._folder / line.name
        played = PlayedLine(place, lambda: _Stand(self, key))
        self._lines.append(played)
        played.open()

    async def pipe(self, sock: socket.socket, protocol: str, peer: str) -> None:
        """Play a child process at one end of a socket pair."""
        loop = asyncio.get_running_loop()
        await loop.create_connection(lambda: _Stand(self, (protocol, peer)), sock=sock)

    def polls(self, protocol: str) -> deque[float]:
        """``ByNumber.polls`` of the newest connection of ``protocol``."""
        newest = self._newest(protocol)
        return deque() if newest is None else newest.polls

    def next_asked(self, protocol: str, question: bytes, after: float = -inf) -> float | None:
        """``ByNumber.next_asked`` of the newest connection of ``protocol``."""
        newest = self._newest(protocol)
        return None if newest is None else newest.next_asked(question, after)

    def _newest(self, protocol: str) -> ByNumber | None:
        found = [p for c, p in self.playing if c.protocol == protocol and isinstance(p, ByNumber)]
        return found[-1] if found else None


class _Stand(asyncio.Protocol):
    """The device's end of one connection."""

    def __init__(self, player: WirePlayer, key: tuple[str, str]) -> None:
        self._player, self._key = player, key
        self._playback: Playback | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.Transport, transport)
        self._playback = self._player.next_connection(self._key, self._transport)
        if self._playback is not None:
            self._playback.begin()

    def data_received(self, data: bytes) -> None:
        if self._playback is not None:
            self._playback.received(data)

    def connection_lost(self, exc: Exception | None) -> None:
        self._player.forget(self._transport)


def moved(recording: WireRecording, by: float) -> WireRecording:
    """The same recording ``by`` s later: played in real time it begins now, however old it is."""
    return WireRecording(
        [
            replace(
                one,
                opened=one.opened + by,
                closed=None if one.closed is None else one.closed + by,
                records=[replace(record, t=record.t + by) for record in one.records],
            )
            for one in recording.connections
        ],
        recording.left_out,
    )


def _place(peer: str) -> tuple[str, int]:
    host, _, port = peer.rpartition("/")[2].rpartition(":")
    if not host or not port.isdecimal():
        raise error("ARGUMENT_INVALID", f"a player serves TCP and serial lines, and the recording has {peer}")
    return host, int(port)
