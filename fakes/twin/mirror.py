"""The camera's process and the pipe that keeps its world in step with the twin's.

Rendering beside the 500 Hz stream would make it stutter, so it has a process of its own. A thread writes
to the pipe: a camera that hangs must never block the controller's loop.
"""

import contextlib
import multiprocessing
import queue
import threading
import time
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Any

from cell.forking import may_fork
from fakes.frames.server import serve_frames
from fakes.wire.lifetime import die_with_parent, run_as_camera, run_as_controller
from fakes.world.world import Message, World

BACKLOG = 20_000  # messages; 40 s of set-points at 500 Hz
JOIN_S = 3.0
_MOST_AT_ONCE = 100
_GATHER_S = 0.008  # some set-points go together; a picture is drawn later than that


class FrameProcess:
    """The frame server as a child; :meth:`send` never blocks."""

    def __init__(self, socket_path: str, scenario: str, world: World) -> None:
        self._arguments = (socket_path, scenario)
        self._world = world
        self._queue: queue.Queue[Message | None] = queue.Queue(BACKLOG)
        self._process: BaseProcess | None = None
        self._pipe: Connection[Any, Any]
        self._thread: threading.Thread | None = None
        self._open = True

    def fork(self) -> None:
        """Make the child a copy of this program, which need not import anything; it waits for :meth:`start`.

        Where a program must not be copied, the child is started later, as one that replaces another.
        """
        if may_fork():
            context = multiprocessing.get_context("fork")
            self._pipe, theirs = context.Pipe()
            arguments = (*self._arguments, theirs, self._pipe)
            self._process = context.Process(target=_serve, args=arguments, daemon=True)
            self._process.start()
            theirs.close()

    def start(self) -> None:
        """Start the child, if it is not there yet, and bring its world to the twin's."""
        if self._process is None:
            context = multiprocessing.get_context("spawn")
            self._pipe, theirs = context.Pipe()
            self._process = context.Process(target=_serve, args=(*self._arguments, theirs), daemon=True)
            self._process.start()
            theirs.close()
        self._thread = threading.Thread(target=self._write, args=(self._pipe,), name="mirror", daemon=True)
        self._thread.start()
        self._world.mirror_to(self.send)

    def send(self, message: Message) -> None:
        """Queue one message; a child that stopped reading long ago loses them."""
        if self._open:
            with contextlib.suppress(queue.Full):
                self._queue.put_nowait(message)

    @property
    def alive(self) -> bool:
        return self._process is not None and self._process.is_alive()

    @property
    def sentinel(self) -> int:
        """A descriptor that becomes readable when the child ends."""
        if self._process is None:
            raise RuntimeError("the frame server has not been started")
        return self._process.sentinel

    def stop(self) -> None:
        """Close the pipe, which ends the child; kill it when it does not go."""
        self._open = False
        with contextlib.suppress(queue.Full):
            self._queue.put_nowait(None)
        if self._process is not None:
            if self._thread is None:  # forked and not begun
                self._pipe.close()
            self._process.join(JOIN_S)
            if self._process.is_alive():
                self._process.kill()
                self._process.join()
        if self._thread is not None:
            self._thread.join(JOIN_S)

    def _write(self, connection: "Connection[Any, Any]") -> None:
        run_as_controller()  # whoever waits for a core here may hold the interpreter's lock
        with connection, contextlib.suppress(OSError):
            over = False
            while not over:
                messages = [self._queue.get()]
                with contextlib.suppress(queue.Empty):
                    while messages[-1] is not None and len(messages) < _MOST_AT_ONCE:
                        messages.append(self._queue.get_nowait())
                over = messages[-1] is None
                connection.send([message for message in messages if message is not None])
                time.sleep(_GATHER_S)


def _serve(
    socket_path: str,
    scenario: str,
    connection: "Connection[Any, Any]",
    not_ours: "Connection[Any, Any] | None" = None,
) -> None:
    """``not_ours``: the parent's end in a copy of it, which would keep the pipe open."""
    if not_ours is not None:
        not_ours.close()
    die_with_parent()
    run_as_camera()
    serve_frames(socket_path, scenario, connection)
