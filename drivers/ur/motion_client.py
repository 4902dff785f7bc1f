"""The daemon's side of the motion child: start it, call it with deadlines, beat, and end it."""

import asyncio
import os
import socket
import subprocess
import sys
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

from cell.answer_time import answer_within
from cell.clock import Clock
from cell.errors import CellError, error, present
from cell.wire_recording.tap import tap
from drivers.ur.framing import Message, Unframer, encode
from drivers.ur.motion_child import EXIT_DEADLINE, EXIT_LINK_LOST
from drivers.ur.script_end import Kicks

BEAT_PERIOD_S = 0.02
# The child has a deadline of its own for every call; this much later it is given up and killed.
GRACE_S = 0.2


class MotionClient:
    """One child process. It is never restarted: after a failure a new client is made."""

    def __init__(self, clock: Clock, process: subprocess.Popen[bytes], pipe: socket.socket) -> None:
        self.clock, self.pid = clock, process.pid
        self.withheld = self.killed = False
        self.kicks = Kicks()
        self.ended = asyncio.Event()
        self.idle = asyncio.Event()  # no trajectory is followed
        self.idle.set()
        self._process, self._pipe = process, pipe
        self._stdout = present(process.stdout, "pipe from the motion child")
        self._loop = asyncio.get_running_loop()
        self._unframer = Unframer()
        self._replies: dict[int, asyncio.Future[Any]] = {}
        self._next_id = 1
        self._turn = asyncio.Lock()
        self._output: deque[bytes] = deque(maxlen=8)
        self._listeners: list[Callable[[Message], None]] = []
        self._tap = tap("motion-child", "child")
        os.set_blocking(self._stdout.fileno(), False)
        # The kernel tells the end of the process through a descriptor, so no thread has to wait for it.
        self._pidfd = os.pidfd_open(process.pid)
        self._loop.add_reader(self._pidfd, self._on_exit)
        self._loop.add_reader(self._stdout.fileno(), self._read_output)
        self._loop.add_reader(pipe.fileno(), self._on_readable)
        self._beating = asyncio.create_task(self._beat(), name=f"beat for motion child {process.pid}")

    @classmethod
    def start(cls, clock: Clock) -> "MotionClient":
        """Start the child process; nothing is connected yet. Call it on the event loop."""
        ours, theirs = socket.socketpair()
        ours.setblocking(False)
        command = [
            sys.executable,
            "-P",
            "-m",
            "drivers.ur.motion_child",
            str(theirs.fileno()),
            str(os.getpid()),
        ]
        try:
            process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                bufsize=0,
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
            async with answer_within(deadline_s + GRACE_S), self._turn:
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

    @property
    def gave_up(self) -> bool:
        """Whether the child ended itself, as it does when the controller does not answer it."""
        return self._process.returncode in (EXIT_DEADLINE, EXIT_LINK_LOST)

    def death(self) -> CellError:
        """Why the child is of no use any more; the watchdog stops the arm in any case."""
        said = b"".join(self._output).decode("utf-8", "replace").strip()[-500:].replace("\n", " / ")
        return error(
            "MOTION_WATCHDOG" if self.gave_up else "CHILD_DIED",
            f"motion child {self.pid}, exit {self._process.returncode}" + (f": {said}" if said else ""),
        )

    def kill(self) -> None:
        """End the child at once; the controller's watchdog stops the arm."""
        self.killed = self.killed or self._process.poll() is None
        self._process.kill()

    async def finish(self, timeout: float) -> None:
        """Wait for the child to go by itself, else kill it; then let go of everything."""
        try:
            async with asyncio.timeout(timeout):
                await self.ended.wait()
        except TimeoutError:
            self.kill()
            await self.ended.wait()  # SIGKILL is not refused
        finally:
            self.kill()
            self._beating.cancel()
            await asyncio.wait([self._beating], timeout=1.0)

    def _send(self, message: Message) -> None:
        try:
            data = encode(message)
        except ValueError as exc:
            raise error("ARGUMENT_INVALID", f"{message.get('do')}: {exc}") from exc
        self._tap.sent(data)
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
        if self._pipe.fileno() < 0:
            return
        try:
            data = self._pipe.recv(65536)
            self._tap.received(data)
            messages = self._unframer.feed(data)
        except BlockingIOError:
            return
        except (OSError, ValueError):
            data, messages = b"", []
        if not data:
            # The process is leaving, or talks nonsense; either way its end will be reported.
            self._loop.remove_reader(self._pipe.fileno())
            self.kill()
            return
        for message in messages:
            self._take(message)

    def _take(self, message: Message) -> None:
        if "event" in message:
            if message["event"] in ("withheld", "kicking"):
                self.withheld = message["event"] == "withheld"
            elif message["event"] == "kicked":
                self.kicks.note(message["at"])
            elif message["event"] == "followed":
                self.idle.set()
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

    def _read_output(self) -> None:
        """What the native client prints; kept for the error when the child dies."""
        try:
            data = os.read(self._stdout.fileno(), 4096)
        except BlockingIOError:
            return
        if data:
            self._output.append(data)
        else:
            self._loop.remove_reader(self._stdout.fileno())

    def _on_exit(self) -> None:
        if self._process.poll() is None:
            return
        self._loop.remove_reader(self._pidfd)
        os.close(self._pidfd)
        self._on_readable()  # its last answer may still be in the pipe
        self._read_output()
        self._loop.remove_reader(self._stdout.fileno())
        self._stdout.close()
        self._close_pipe()
        self.idle.set()
        self.ended.set()
        for reply in self._replies.values():
            if not reply.done():
                reply.set_exception(self.death())
        for listener in tuple(self._listeners):
            listener({"event": "died"})

    def _close_pipe(self) -> None:
        if self._pipe.fileno() >= 0:
            self._loop.remove_reader(self._pipe.fileno())
            self._pipe.close()
            self._tap.closed()


def _environment() -> dict[str, str]:
    """The child finds our packages where we found them."""
    root = str(Path(__file__).resolve().parents[2])
    inherited = os.environ.get("PYTHONPATH")
    return {**os.environ, "PYTHONPATH": root if not inherited else f"{root}{os.pathsep}{inherited}"}
