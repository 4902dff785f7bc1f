"""The daemon's side of the vision child: its process, its pipe, and the answers to requests."""

import asyncio
import contextlib
import os
import signal
import socket
import sys
from collections import deque
from collections.abc import Callable
from typing import Any

from cell.answer_time import answer_within
from cell.errors import CellError, error
from cell.wire_recording.tap import NO_TAP, Tap, tap
from drivers.life import Life
from drivers.oak.protocol import LENGTH, Message, body_length, error_from_json, pack, unpack

_EXIT_TIMEOUT_S = 1.5
_KEPT_LINES = 5


class ChildLink:
    """One child from start to end; never used again after it was lost.

    ``on_message`` gets everything that is not an answer. What ends the child ends ``life``.
    """

    def __init__(self, name: str, life: Life, on_message: Callable[[Message], None]) -> None:
        self.name = name
        self._life = life
        self._on_message = on_message
        self._process: asyncio.subprocess.Process | None = None
        self._writer: asyncio.StreamWriter | None = None
        self._tasks: list[asyncio.Task[None]] = []
        self._requests: dict[int, asyncio.Future[Message]] = {}
        self._number = 0
        self._last_words: deque[str] = deque(maxlen=_KEPT_LINES)
        self._tap: Tap = NO_TAP

    @property
    def pid(self) -> int | None:
        """Of the child, for health pages and tests."""
        return self._process.pid if self._process else None

    async def start(self, module: str) -> None:
        """Start ``python -m module`` with one end of a socket pair; close when this raises."""
        ours, theirs = socket.socketpair()
        try:
            self._process = await asyncio.create_subprocess_exec(
                sys.executable,
                "-P",  # a folder with another "daemon" to start in must not shadow ours
                "-m",
                module,
                str(theirs.fileno()),
                str(os.getpid()),
                pass_fds=(theirs.fileno(),),
                stdin=asyncio.subprocess.DEVNULL,
                stdout=asyncio.subprocess.DEVNULL,
                stderr=asyncio.subprocess.PIPE,
                # The kernel shares busy cores between sessions first (autogroup): with a share of its own the
                # child keeps up with the pictures, and takes nothing from the daemon's loop.
                start_new_session=True,
            )
            ours.setblocking(False)
            reader, self._writer = await asyncio.open_connection(sock=ours)
        except BaseException:
            ours.close()
            raise
        finally:
            theirs.close()
        self._tap = tap("vision-child", self.name)
        self._tasks = [
            asyncio.create_task(self._listen(reader, self._process), name=f"{self.name} child"),
            asyncio.create_task(self._collect(self._process), name=f"{self.name} child stderr"),
        ]

    def send(self, message: Message) -> None:
        """Hand ``message`` to the child; does not wait for it to be read."""
        if self._writer is not None and not self._writer.is_closing():
            data = pack(message)
            self._tap.sent(data)
            self._writer.write(data)

    def tell(self, message: Message) -> None:
        """Send a command of which nobody awaits the answer."""
        self.send({**message, "id": self._next_number()})

    async def request(self, message: Message, timeout: float) -> Message:
        """Send ``message`` and return the answer; its error, the loss of the link, or ``CALL_TIMEOUT``."""
        self._life.require()
        number = self._next_number()
        answer: asyncio.Future[Message] = asyncio.get_running_loop().create_future()
        self._requests[number] = answer
        self.send({**message, "id": number})
        try:
            async with answer_within(timeout):
                reply = await answer
        except TimeoutError:
            raise error(
                "CALL_TIMEOUT", f"{self.name}: no answer to {message['type']!r} within {timeout:.1f} s"
            ) from None
        finally:
            del self._requests[number]
        if "error" in reply:
            raise error_from_json(reply["error"])
        return reply

    def _next_number(self) -> int:
        self._number += 1
        return self._number

    def lose(self, failure: CellError) -> None:
        """End the link with ``failure``; the first error stays, and is that of every request."""
        self._life.lose(failure)
        for answer in self._requests.values():
            if not answer.done():
                answer.set_exception(self._life.failure or failure)

    async def close(self) -> None:
        """End the child; a child that does not go soon is killed."""
        self.lose(error("DEVICE_LOST", f"{self.name} was closed"))
        if self._writer is not None:
            self._writer.close()
            self._tap.closed()
        process = self._process
        if process is not None:
            try:
                async with asyncio.timeout(_EXIT_TIMEOUT_S):
                    await process.wait()
            except TimeoutError:
                pass
            finally:  # also when the closing itself is cancelled
                if process.returncode is None:
                    with contextlib.suppress(ProcessLookupError):
                        process.kill()
                for task in self._tasks:
                    task.cancel()
            await process.wait()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    async def _listen(self, reader: asyncio.StreamReader, process: asyncio.subprocess.Process) -> None:
        try:
            while True:
                prefix = await reader.readexactly(LENGTH.size)
                body = await reader.readexactly(body_length(prefix))
                self._tap.received(prefix + body)
                self._dispatch(unpack(body))
        except (asyncio.IncompleteReadError, OSError):
            self.lose(await self._death(process))
        except CellError as exc:
            self.lose(exc)
        except (KeyError, TypeError, ValueError) as exc:
            self.lose(error("PROTOCOL_VIOLATION", f"{self.name}: vision child: {type(exc).__name__} {exc}"))

    def _dispatch(self, message: Message) -> None:
        if message["type"] == "failed":
            self.lose(error_from_json(message))
        elif message["type"] == "answer":
            answer = self._requests.get(message["id"])
            if answer is not None and not answer.done():
                answer.set_result(message)
        else:
            self._on_message(message)

    async def _death(self, process: asyncio.subprocess.Process) -> CellError:
        """Why the child is gone, as its exit status and its last words tell."""
        try:
            async with asyncio.timeout(_EXIT_TIMEOUT_S):
                code = await process.wait()
        except TimeoutError:
            return error("CHILD_DIED", f"{self.name}: the vision child closed its pipe and hangs")
        if len(self._tasks) > 1:
            await asyncio.wait([self._tasks[1]], timeout=_EXIT_TIMEOUT_S)
        words = " | ".join(self._last_words)
        return error("CHILD_DIED", f"{self.name}: the vision child {_exit(code)}{words and ': ' + words}")

    async def _collect(self, process: asyncio.subprocess.Process) -> None:
        while process.stderr and (chunk := await process.stderr.read(65536)):
            self._last_words.extend(chunk.decode(errors="replace").strip()[-500:].splitlines())


def _exit(code: int) -> str:
    if code >= 0:
        return f"exited with status {code}"
    try:
        return f"was ended by {signal.Signals(-code).name}"
    except ValueError:
        return f"was ended by signal {-code}"


def identity_fields(message: Message) -> dict[str, Any]:
    """What a ``ready`` message says of the device."""
    return {key: message[key] for key in ("model", "serial", "version", "extra")}
