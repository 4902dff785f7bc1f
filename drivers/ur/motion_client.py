"""The daemon's side of the motion child: start it, call it with deadlines, beat, and end it."""

import asyncio
import os
import socket
import sys
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

from cell.clock import Clock
from cell.errors import CellError, error
from drivers.ur.framing import Message, Unframer, encode

BEAT_PERIOD_S = 0.02
# The child has a deadline of its own for every call; this much later it is given up and killed.
GRACE_S = 0.2


class MotionClient:
    """One child process. It is never restarted: after a failure a new client is made."""

    def __init__(self, clock: Clock, process: asyncio.subprocess.Process, pipe: socket.socket) -> None:
        self.clock, self.pid = clock, process.pid
        self.withheld = False
        self.ended = asyncio.Event()
        self._process, self._pipe = process, pipe
        self._loop = asyncio.get_running_loop()
        self._unframer = Unframer()
        self._replies: dict[int, asyncio.Future[Any]] = {}
        self._next_id = 1
        self._turn = asyncio.Lock()
        self._output: deque[str] = deque(maxlen=20)
        self._listeners: list[Callable[[Message], None]] = []
        self._tasks = [
            asyncio.create_task(self._beat(), name="motion child beat"),
            asyncio.create_task(self._read_output(), name="motion child output"),
            asyncio.create_task(self._watch_process(), name="motion child watch"),
        ]
        self._loop.add_reader(pipe.fileno(), self._on_readable)

    @classmethod
    async def start(cls, clock: Clock) -> "MotionClient":
        """Start the child process; nothing is connected yet."""
        ours, theirs = socket.socketpair()
        try:
            ours.setblocking(False)
            process = await asyncio.create_subprocess_exec(
                *(
                    sys.executable,
                    "-P",
                    "-m",
                    "drivers.ur.motion_child",
                    str(theirs.fileno()),
                    str(os.getpid()),
                ),
                stdin=asyncio.subprocess.DEVNULL,
                stdout=asyncio.subprocess.PIPE,
                stderr=asyncio.subprocess.STDOUT,
                pass_fds=[theirs.fileno()],
                env=_environment(),
            )
        except BaseException:
            ours.close()
            raise
        finally:
            theirs.close()
        return cls(clock, process, ours)

    async def call(self, do: str, deadline_s: float, **arguments: Any) -> Any:
        """One command; calls wait for each other. ``CALL_TIMEOUT`` kills the child.

        ``CHILD_DIED`` when it is dead, or with what the native client said when it refused the command.
        """
        try:
            async with asyncio.timeout(deadline_s + GRACE_S), self._turn:
                number, self._next_id = self._next_id, self._next_id + 1
                reply = self._loop.create_future()
                self._replies[number] = reply
                try:
                    self._send({"id": number, "do": do, "deadline_s": deadline_s, "with": arguments})
                    return await reply
                finally:
                    del self._replies[number]
        except TimeoutError:
            self.kill()
            raise error(
                "CALL_TIMEOUT", f"'{do}' in the motion child had no answer in {deadline_s:g} s"
            ) from None

    def post(self, do: str, **arguments: Any) -> None:
        """A command without an answer, sent at once; a child that is gone needs none."""
        if not self.ended.is_set():
            self._send({"do": do, "deadline_s": 0.5, "with": arguments})

    def subscribe(self, listener: Callable[[Message], None]) -> Callable[[], None]:
        """Call ``listener`` on every event of the child; the returned function ends that."""
        self._listeners.append(listener)
        return lambda: self._listeners.remove(listener)

    def death(self) -> CellError:
        """Why the child is of no use any more."""
        said = " / ".join(self._output)
        return error(
            "CHILD_DIED",
            f"motion child {self.pid}, exit {self._process.returncode}" + (f": {said}" if said else ""),
        )

    def kill(self) -> None:
        """End the child at once; the controller's watchdog stops the arm."""
        if self._process.returncode is None:
            self._process.kill()

    async def finish(self, timeout: float) -> None:
        """Wait for the child to go by itself, else kill it; then let go of everything."""
        try:
            async with asyncio.timeout(timeout):
                await self._process.wait()
        except TimeoutError:
            self.kill()
        finally:
            self.kill()
            self._close_pipe()
            self._tasks[0].cancel()
            await asyncio.wait(self._tasks, timeout=2.0)

    def _send(self, message: Message) -> None:
        try:
            data = encode(message)
        except ValueError as exc:
            raise error("ARGUMENT_INVALID", f"{message.get('do')}: {exc}") from exc
        try:
            sent = self._pipe.send(data)
        except BlockingIOError:
            sent = 0
        except OSError:
            raise self.death() from None
        if sent != len(data):
            # The child has not read for thousands of beats, and half a message would spoil the rest.
            self.kill()
            raise error("CHILD_DIED", f"motion child {self.pid} does not read its pipe")

    def _on_readable(self) -> None:
        try:
            data = self._pipe.recv(65536)
            messages = self._unframer.feed(data)
        except BlockingIOError:
            return
        except (OSError, ValueError):
            data, messages = b"", []
        if not data:
            self._loop.remove_reader(self._pipe.fileno())
            self.kill()
            return
        for message in messages:
            self._take(message)

    def _take(self, message: Message) -> None:
        if "event" in message:
            self.withheld = self.withheld or message["event"] == "withheld"
            for listener in tuple(self._listeners):
                listener(message)
            return
        reply = self._replies.get(message["id"])
        if reply is None or reply.done():
            return
        if message["ok"]:
            reply.set_result(message["value"])
        else:
            reply.set_exception(error("CHILD_DIED", f"the motion client refused: {message['text']}"))

    async def _beat(self) -> None:
        try:
            while not self.ended.is_set():
                self._send({"beat": self.clock.now()})
                await self.clock.sleep(BEAT_PERIOD_S)
        except CellError:
            self.kill()

    async def _read_output(self) -> None:
        assert self._process.stdout is not None
        while line := await self._process.stdout.readline():
            self._output.append(line.decode("utf-8", "replace").strip()[:300])

    async def _watch_process(self) -> None:
        await self._process.wait()
        self.ended.set()
        self._close_pipe()
        for reply in self._replies.values():
            if not reply.done():
                reply.set_exception(self.death())
        for listener in tuple(self._listeners):
            listener({"event": "died"})

    def _close_pipe(self) -> None:
        if self._pipe.fileno() >= 0:
            self._loop.remove_reader(self._pipe.fileno())
            self._pipe.close()


def _environment() -> dict[str, str]:
    """The child finds our packages where we found them."""
    root = str(Path(__file__).resolve().parents[2])
    inherited = os.environ.get("PYTHONPATH")
    return {**os.environ, "PYTHONPATH": root if not inherited else f"{root}{os.pathsep}{inherited}"}
