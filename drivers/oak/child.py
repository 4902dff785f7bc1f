"""The vision child: owns the camera and the detector, and ends with its parent.

The main thread waits for frames and looks at them; a second thread reads the pipe. When the pipe closes
the process exits within a second, whatever hangs, and the kernel kills it when the daemon dies.
"""

import ctypes
import os
import queue
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, NoReturn, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from cell.devices import BoardView, Frame, Intrinsics, ItemView
from cell.errors import CellError, error
from cell.priority import weigh_session, yield_to_others
from drivers.oak.capture import FrameCapture
from drivers.oak.config import OakConfig
from drivers.oak.protocol import Message, error_to_json, frame_to_json, pack, read_message

if TYPE_CHECKING:
    from drivers.oak.pipeline import FrameSource, Shot

_QUIET = {
    "DEPTHAI_TELEMETRY": "0",
    "DEPTHAI_INSTALL_SIGNAL_HANDLER": "0",
    "DEPTHAI_DISABLE_STARTUP_NOTIFICATIONS": "1",
    "DEPTHAI_DISABLE_CRASHDUMP_COLLECTION": "1",
}
_SEARCH_TIMEOUT_MS = "5000"  # for a device; the library's own is longer than the driver waits
_PR_SET_PDEATHSIG = 1
_WAIT_S = 0.1
_CLOSE_S = 1.0


class Detection(Protocol):
    """``corners[i]`` (pixels) is the image of target point ``ids[i]``."""

    @property
    def ids(self) -> Any: ...  # (n,)
    @property
    def corners(self) -> Any: ...  # (n, 2)


class Detector(Protocol):
    """Looks for one target in a grey image."""

    def detect(self, image: NDArray[np.uint8]) -> Detection | None: ...


class ItemFinder(Protocol):
    """Looks for items in a colour image (h, w, 3) BGR with aligned depth (h, w) in mm, None of a camera
    without; then ``CAMERA_FAULT`` where depth is needed."""

    def find(self, colour: NDArray[np.uint8], depth: NDArray[np.uint16] | None) -> tuple[ItemView, ...]: ...


@dataclass(frozen=True)
class Detectors:
    """How the child makes what looks at frames, from the tables that the daemon sends.

    ``items`` checks its table at once and gives a factory for the camera that turns out to be there.
    """

    target: Callable[[Mapping[str, Any]], Detector]
    items: Callable[[Mapping[str, Any]], Callable[[Intrinsics], ItemFinder]]


def main(detectors: Detectors) -> None:
    """Run the child on the socket whose descriptor is the first argument; returns never."""
    parent = int(sys.argv[2])
    ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(0)  # the daemon died before the request was in force
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C goes to the whole group; the daemon ends us
    weigh_session(os.getpriority(os.PRIO_PROCESS, 0))  # among other programs, the daemon's share
    yield_to_others()
    os.environ.update(_QUIET)
    os.environ.setdefault("DEPTHAI_SEARCH_TIMEOUT", _SEARCH_TIMEOUT_MS)
    cv2.setNumThreads(1)
    link = ParentLink(socket.socket(fileno=int(sys.argv[1])))
    link.wait_for_commands()
    try:
        VisionChild(link, detectors).run()
    except Exception as exc:
        link.fail(exc)
    os._exit(0)  # native threads may not want to end


class ParentLink:
    """The pipe to the daemon; commands arrive on a thread of their own."""

    def __init__(self, connection: socket.socket) -> None:
        self.commands: queue.SimpleQueue[Message] = queue.SimpleQueue()
        self.closed = threading.Event()
        self._connection = connection
        self._sending = threading.Lock()  # answers come from the writer's threads too

    def wait_for_commands(self) -> None:
        """Begin to read; ``closed`` is set when the daemon closes, and the process ends soon after."""
        threading.Thread(target=self._read, name="commands", daemon=True).start()

    def send(self, message: Message) -> None:
        """Tell the daemon; a daemon that is gone ends this process."""
        try:
            with self._sending:
                self._connection.sendall(pack(message))
        except OSError:
            os._exit(0)

    def fail(self, exc: Exception) -> NoReturn:
        """Say why, and end this process at once: closing a camera that failed may hang."""
        self.send({"type": "failed", **error_to_json(exc)})
        os._exit(1)

    def _read(self) -> None:
        with self._connection.makefile("rb") as file:
            try:
                while (message := read_message(file.read)) is not None:
                    self.commands.put(message)
            except (CellError, OSError) as exc:
                print(f"commands: {exc}", file=sys.stderr, flush=True)  # noqa: T201
        self.closed.set()
        # A device that is closed in order can be opened again sooner; but nothing waits for it long.
        time.sleep(_CLOSE_S)
        os._exit(0)


class VisionChild:
    """Looks at frames and answers commands, between which nothing is shared."""

    def __init__(self, link: ParentLink, detectors: Detectors) -> None:
        self._link, self._detectors = link, detectors
        self._detector: Detector | None = None
        self._finder_for: Callable[[Intrinsics], ItemFinder] | None = None
        self._finder: tuple[Intrinsics, ItemFinder] | None = None
        self._captures: list[FrameCapture] = []
        # One thread: on a machine that is too busy, files come late before frames are missed.
        self._writer = ThreadPoolExecutor(1, "png")

    def run(self) -> None:
        """Serve until the daemon closes; an error of opening leaves this method, a later one the process."""
        first = self._link.commands.get()
        config = OakConfig.model_validate(first["config"])
        self._choose(first["target"])
        self._choose_items(first["items"])
        from drivers.oak.pipeline import open_source  # imports depthai, which reads the environment

        with open_source(config) as source:
            try:
                self._serve(source, config.time_offset_s)
            except Exception as exc:
                self._link.fail(exc)

    def _serve(self, source: "FrameSource", time_offset_s: float) -> None:
        ready = False
        while not self._link.closed.is_set():
            self._obey()
            source.light(self._finder_for is not None)
            shot = source.next(_WAIT_S)
            if shot is None:
                continue
            if not ready:
                self._introduce(source.identity)
                ready = True
            self._look(shot, source.identity.serial, time_offset_s)

    def _introduce(self, identity: Any) -> None:
        fields = ("model", "serial", "version", "extra")
        self._link.send({"type": "ready", **{f: getattr(identity, f) for f in fields}})

    def _obey(self) -> None:
        while True:
            try:
                message = self._link.commands.get_nowait()
            except queue.Empty:
                return
            try:
                self._command(message)
            except Exception as exc:
                self._answer(message["id"], {"error": error_to_json(exc)})

    def _command(self, message: Message) -> None:
        if message["type"] == "target":
            self._choose(message["target"])
            self._answer(message["id"], {})
        elif message["type"] == "items":
            self._choose_items(message["items"])
            self._answer(message["id"], {})
        elif message["type"] == "capture":
            answer = partial(self._answer, message["id"])
            self._captures.append(FrameCapture(message, self._writer, answer))
        else:
            raise error("PROTOCOL_VIOLATION", f"the vision child knows no command {message['type']!r}")

    def _choose(self, target: Mapping[str, Any] | None) -> None:
        self._detector = None if target is None else self._detectors.target(target)

    def _choose_items(self, spec: Mapping[str, Any] | None) -> None:
        self._finder_for = None if spec is None else self._detectors.items(spec)
        self._finder = None

    def _look(self, shot: "Shot", serial: str, time_offset_s: float) -> None:
        grey = cv2.cvtColor(shot.colour, cv2.COLOR_BGR2GRAY)
        frame = Frame(
            seq=shot.seq,
            t_exposure=shot.t_exposure - time_offset_s,
            exposure_s=shot.exposure_s,
            intrinsics=shot.intrinsics,
            board=self._board(grey),
            serial=serial,
            items=self._items(shot),
            row_time_s=shot.row_time_s,
        )
        self._link.send({"type": "frame", "mean_grey": _mean(grey), "frame": frame_to_json(frame)})
        for capture in self._captures:
            capture.offer(frame, shot.colour, shot.depth)
        self._captures = [c for c in self._captures if not c.complete]

    def _board(self, grey: NDArray[np.uint8]) -> BoardView | None:
        """Not while items are looked for: no job needs both, and each takes its time."""
        if self._detector is None or self._finder_for is not None:
            return None
        found = self._detector.detect(grey)
        if found is None or len(found.ids) == 0:
            return None
        ids = np.asarray(found.ids, dtype=np.int64).ravel()
        return BoardView(ids, np.asarray(found.corners, dtype=float).reshape(-1, 2), _mean(grey))

    def _items(self, shot: "Shot") -> tuple[ItemView, ...] | None:
        if self._finder_for is None:
            return None
        if self._finder is None or self._finder[0] != shot.intrinsics:
            self._finder = shot.intrinsics, self._finder_for(shot.intrinsics)
        return self._finder[1].find(shot.colour, shot.depth)

    def _answer(self, request: int, fields: Message) -> None:
        self._link.send({"type": "answer", "id": request, **fields})


def _mean(grey: NDArray[np.uint8]) -> float:
    """Mean of every eighth row and column: a light meter, not a measurement."""
    return float(grey[::8, ::8].mean())
