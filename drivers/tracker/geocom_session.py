"""One GeoCOM conversation: one request outstanding, replies matched by number, late ones dropped."""

import asyncio
import itertools
from collections.abc import Callable
from dataclasses import dataclass

from cell.answer_time import answer_within
from cell.clock import Clock
from drivers.tracker.geocom_codes import Meaning, ReturnCode, return_code
from drivers.tracker.geocom_text import Parameter, Reply, Unreadable, parse_reply, request
from drivers.tracker.wire import Lines

_ABORT = b"c\r\n"
_CLEAR = b"\n"
_MOST_TRANSACTIONS = 32767


class NoAnswer(Exception):
    """No reply, or none that can be used, to one request."""


@dataclass(frozen=True)
class GeocomAnswer:
    """A reply, and the seconds between which it was asked for and came."""

    reply: Reply
    begin: float
    end: float

    @property
    def code(self) -> ReturnCode:
        return return_code(self.reply.code)


class GeocomSession:
    """Feed it with :meth:`received`; ``counts`` are for status pages."""

    def __init__(self, write: Callable[[bytes], None], clock: Clock, checksum: bool) -> None:
        self._write, self._clock, self._checksum = write, clock, checksum
        self._lines, self._numbers = Lines(), itertools.cycle(range(1, _MOST_TRANSACTIONS + 1))
        self._turn = asyncio.Lock()
        self._waiting: tuple[int, asyncio.Future[Reply]] | None = None
        self._unclean = True  # what the instrument's receiver holds is unknown
        self._ended = ""
        self.counts = {"requests": 0, "timeouts": 0, "late": 0, "unreadable": 0}

    def received(self, data: bytes) -> None:
        """Bytes of the line, as they come."""
        for line in self._lines.feed(data):
            if line.strip() != b"?":  # what an abort is acknowledged with
                self._take(line)

    def end(self, reason: str) -> None:
        """The line is gone: whoever waits need not."""
        self._ended = reason
        if self._waiting and not self._waiting[1].done():
            self._waiting[1].set_exception(NoAnswer(reason))

    async def ask(
        self,
        rpc: int,
        *parameters: Parameter,
        timeout: float,
        tries: int = 2,
        abort: bool = False,
        numbers: int = 0,
    ) -> GeocomAnswer:
        """Ask until there is a reply that can be used; :class:`NoAnswer` after ``tries`` without one.

        ``abort``: a procedure that moves the instrument is stopped when nobody waits for it any more.
        ``numbers``: data with fewer numbers than that are damaged; :class:`Unreadable` when the last are.
        """
        reason, damage = "", None
        for _ in range(tries):
            if self._ended:
                break
            async with self._turn:
                try:
                    answer = await self._once(rpc, parameters, timeout, abort)
                except NoAnswer as exc:
                    reason = str(exc)
                    continue
            damage = None
            if answer.code.meaning is Meaning.LINE:
                self._unclean, reason = True, f"return code {answer.code}"
                continue
            try:
                if answer.code.has_data:
                    answer.reply.floats(numbers)
                return answer
            except Unreadable as exc:
                self._unclean, damage = True, exc
                self.counts["unreadable"] += 1
        raise (None if self._ended else damage) or NoAnswer(self._ended or reason)

    async def _once(
        self, rpc: int, parameters: tuple[Parameter, ...], timeout: float, abort: bool
    ) -> GeocomAnswer:
        number = next(self._numbers)
        line = request(rpc, number, *parameters, checksum=self._checksum)
        future: asyncio.Future[Reply] = asyncio.get_running_loop().create_future()
        self._waiting = number, future
        self.counts["requests"] += 1
        begin = self._clock.now()
        self._write(_CLEAR + line if self._unclean else line)
        self._unclean = True  # until the reply is there
        given_up = True
        try:
            async with answer_within(timeout):
                reply = await future
            self._unclean = given_up = False
        except TimeoutError as exc:
            self.counts["timeouts"] += 1
            raise NoAnswer(f"no answer in {timeout:.3g} s") from exc
        except NoAnswer:
            given_up = False
            raise
        finally:
            self._waiting = None
            if abort and given_up:
                self._write(_ABORT)
        return GeocomAnswer(reply, begin, self._clock.now())

    def _take(self, line: bytes) -> None:
        try:
            reply = parse_reply(line, checksum=self._checksum)
        except Unreadable as exc:
            self.counts["unreadable"] += 1
            if line.startswith(b"%R1P") and self._waiting and not self._waiting[1].done():
                self._waiting[1].set_exception(NoAnswer(f"a reply with {exc}"))  # it will not come again
            return
        number, waiting = self._waiting or (None, None)
        # Whoever could not read a request does not know its number either.
        answers = reply.transaction == number or (reply.transaction == 0 and reply.com != 0)
        if waiting is None or waiting.done() or not answers:
            self.counts["late"] += 1
        else:
            waiting.set_result(reply)
