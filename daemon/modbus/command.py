"""Commands with sequence numbers: each is carried out once, in order, and a stop never queues."""

import asyncio
import logging
import struct
from collections.abc import Awaitable, Callable
from dataclasses import dataclass

from cell.errors import catalogue

log = logging.getLogger("cellward.modbus")

ACCEPTED, DONE, REFUSED = 1, 2, 0x8000
START, ABORT, HALT, RESET = 1, 3, 4, 7
STOPPING = frozenset({ABORT, HALT})
DEADLINE_S = 10.0
WITHDRAW_S = 0.2
KEEP_S = 1.0  # so long a command waits until its number is on disk
MAX_WAITING = 8


def refused(name: str) -> int:
    """The result code that says why nothing was done."""
    return REFUSED | catalogue()[name].code


@dataclass(frozen=True)
class Command:
    """One command of one channel. ``args`` are the six argument registers as they came."""

    code: int
    sequence: int
    job: int = 0
    flags: int = 0
    args: tuple[int, ...] = (0, 0, 0, 0, 0, 0)
    channel: str = "modbus"
    client: str = ""
    low_first: bool = False

    def argument_as_uint32(self, index: int) -> int:
        """Argument ``index`` (0, 1, 2) as uint32."""
        value: int = struct.unpack(">I", self._bytes(index))[0]
        return value

    @property
    def argument_uint32(self) -> int:
        """The first argument as uint32: a run id or a prompt id."""
        return self.argument_as_uint32(0)

    def _bytes(self, index: int) -> bytes:
        first, second = self.args[2 * index : 2 * index + 2]
        return struct.pack(">HH", second, first) if self.low_first else struct.pack(">HH", first, second)


class CommandChannel:
    """The sequence of one channel: the same number again does nothing, a new one acts once.

    The number is remembered on disk *before* the command is carried out: after a kill in between a repeated
    request does nothing, so nothing moves by itself. A disk that takes longer than ``KEEP_S``, or fails,
    holds up no command but a start, which is refused with ``DISK_FAILED``: without its number, the same
    request would start the job again after a restart. A stop acts first and is remembered after; it
    withdraws the commands before it that are still under way, so that no start comes out behind its stop.
    """

    def __init__(
        self,
        handler: Callable[[Command], Awaitable[int]],
        last_sequence: int = 0,
        remember: Callable[[int], None] | None = None,
        report: Callable[[Command, int], None] = lambda command, result: None,
    ) -> None:
        """``handler`` gives a result code; ``remember`` writes a number to disk and may block."""
        self.acknowledged, self.result = last_sequence, 0
        self._handler, self._remember, self._report = handler, remember, report
        self._taken, self._arrivals, self._answered, self._kept = last_sequence, 0, 0, 0
        self._in_order = asyncio.Lock()
        self._tasks: set[asyncio.Task[None]] = set()
        self._writing: asyncio.Task[bool] | None = None  # of the newest number

    def offer(self, command: Command) -> bool:
        """Take a command if its sequence is new; True when it was taken. Never blocks."""
        if command.sequence in (0, self._taken):
            return False
        self._taken = command.sequence
        self._arrivals += 1
        earlier = tuple(self._tasks)
        task = asyncio.create_task(
            self._carry_out(command, self._arrivals, earlier), name=f"command {command.code}"
        )
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return True

    async def stop(self) -> None:
        """Cancel what is still under way."""
        tasks = tuple(self._tasks)
        for task in tasks:
            task.cancel()
        if tasks:
            await asyncio.wait(tasks, timeout=2.0)
        if self._writing is not None:
            await asyncio.wait([self._writing], timeout=2.0)
            self._writing.cancel()

    async def _carry_out(
        self, command: Command, arrival: int, earlier: tuple[asyncio.Task[None], ...]
    ) -> None:
        if command.code in STOPPING:
            await self._withdraw(earlier)
            result = await self._handled(command)
            await self._keep(command.sequence, arrival)
        elif len(earlier) >= MAX_WAITING:
            result = refused("BUSY")
            await self._keep(command.sequence, arrival)
        else:
            try:
                async with self._in_order:
                    kept = await self._keep(command.sequence, arrival)
                    if command.code == START and not kept:
                        result = refused("DISK_FAILED")
                    else:
                        result = await self._handled(command)
            except asyncio.CancelledError:
                self._report(command, refused("NOT_NOW"))
                raise
        if arrival > self._answered:
            self._answered, self.acknowledged, self.result = arrival, command.sequence, result
        self._report(command, result)

    async def _withdraw(self, earlier: tuple[asyncio.Task[None], ...]) -> None:
        for task in earlier:
            task.cancel()
        if earlier:
            await asyncio.wait(earlier, timeout=WITHDRAW_S)

    async def _handled(self, command: Command) -> int:
        try:
            async with asyncio.timeout(DEADLINE_S):
                return await self._handler(command)
        except TimeoutError:
            log.error("%s: command %d had no answer within %g s", command.client, command.code, DEADLINE_S)
            return refused("CALL_TIMEOUT")
        except Exception:
            log.exception("%s: command %d", command.client, command.code)
            return refused("INTERNAL")

    async def _keep(self, sequence: int, arrival: int) -> bool:
        """Remember the newest; a command that a stop overtook does not push the stop's number back. True
        when that is done."""
        if self._remember is None or arrival < self._kept:
            return True
        self._kept = arrival
        self._writing = asyncio.create_task(
            self._write(self._remember, self._writing, sequence), name="keep the sequence"
        )
        done, _ = await asyncio.wait([self._writing], timeout=KEEP_S)
        return any(task.result() for task in done)

    @staticmethod
    async def _write(
        remember: Callable[[int], None], before: asyncio.Task[bool] | None, sequence: int
    ) -> bool:
        """One after the other: of two that waited for the disk the newer one is written last."""
        if before is not None:
            await asyncio.wait([before])
        try:
            await asyncio.to_thread(remember, sequence)
        except Exception:
            log.exception("the sequence %d could not be written down", sequence)
            return False
        return True
