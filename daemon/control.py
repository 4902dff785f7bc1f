"""The control socket: how the command line talks to the running daemon.

A unix stream socket of mode 0660; one JSON object a line. A request ``{"id", "method", "params"}`` is
answered by ``{"id", "result"}`` or ``{"id", "error": {"code", "name", "text", "hint"}}``. After ``watch``
the connection carries ``{"id", "event": "status", "data"}`` until one side closes it.
"""

import asyncio
import errno
import json
import logging
import os
import pwd
import socket
import stat
import struct
import time
from pathlib import Path
from typing import Any

from cell.errors import error
from daemon.auditor import Audit, Auditor
from daemon.requests import Caller, EngineControl, Params, carry_out, check_bounds, described, live, too_deep

log = logging.getLogger("cellward.control")

MAX_REQUEST_BYTES = 1 << 20
WATCH_PERIOD_S = 0.2  # status events come at most this often ...
WATCH_IDLE_S = 2.0  # ... and at least this often, so that a reader can tell quiet from dead
SEND_TIMEOUT_S = 5.0
STOP_TIMEOUT_S = 2.0
PROBE_TIMEOUT_S = 1.0
MAX_CONNECTIONS = 64


class ControlServer:
    """Serves one engine on one socket file.

    ``audit(who, what, accepted, detail)`` is called for every write, carried out or refused; it may block.
    """

    def __init__(self, path: Path, engine: EngineControl, audit: Audit | None = None) -> None:
        self.path = path
        self._engine, self._auditor = engine, Auditor(audit)
        self._server: asyncio.Server | None = None
        self._inode: int | None = None
        self._connections: dict[asyncio.Task[None], _Connection] = {}

    async def start(self) -> None:
        """Listen. The file of a killed daemon is replaced; ``DAEMON_RUNNING`` when one still answers."""
        await _refuse_unless_free(self.path)
        listener = _bind(self.path)
        self._inode = self.path.stat().st_ino
        self._auditor.start()
        self._server = await asyncio.start_unix_server(self._accept, sock=listener, limit=MAX_REQUEST_BYTES)

    async def stop(self) -> None:
        """Close every connection and take the socket file away; within a few seconds, may be repeated."""
        if self._server is None:
            return
        self._server.close()
        self._server = None
        for task in self._connections:
            task.cancel()
        if self._connections:
            await asyncio.wait(self._connections, timeout=STOP_TIMEOUT_S)
        await self._auditor.stop()
        if self.path.exists() and self.path.stat().st_ino == self._inode:
            self.path.unlink()

    def _accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if not self._make_room():
            text = f"the control socket serves {MAX_CONNECTIONS} connections at most, and all await an answer"
            writer.write(_refusal_line(text))
            writer.close()
            return
        connection = _Connection(self._engine, self._auditor, reader, writer)
        task = asyncio.create_task(self._serve(connection), name="control connection")
        self._connections[task] = connection

        def ended(task: asyncio.Task[None]) -> None:
            self._connections.pop(task, None)
            writer.close()  # not in the task: one that is cancelled before its first step closes nothing

        task.add_done_callback(ended)

    def _make_room(self) -> bool:
        """Whether there is a place for a newcomer, who may want to halt.

        The connection that has asked nothing for longest gives up its own, one that watches after all
        others. One that awaits the answer to a request never does.
        """
        staying = {task: each for task, each in self._connections.items() if not each.leaving}
        if len(staying) < MAX_CONNECTIONS:
            return True
        idle = [(each.watching, each.heard, task) for task, each in staying.items() if not each.answering]
        if not idle:
            return False
        task = min(idle, key=lambda entry: entry[:2])[2]
        staying[task].leave()
        task.cancel()
        return True

    async def _serve(self, connection: "_Connection") -> None:
        try:
            await connection.run()
        except (ConnectionError, TimeoutError) as exc:
            log.info("%s: the connection ended: %s", connection.who, exc or type(exc).__name__)


class _Connection:
    """One client: its requests are answered in their order."""

    def __init__(
        self,
        engine: EngineControl,
        auditor: Auditor,
        reader: asyncio.StreamReader,
        writer: asyncio.StreamWriter,
    ) -> None:
        self._engine, self._auditor, self._reader, self._writer = engine, auditor, reader, writer
        self.who = peer_name(writer.get_extra_info("socket"))
        self.heard = time.monotonic()  # the newest whole request, or the connection's beginning
        self.answering = self.watching = self.leaving = False

    def leave(self) -> None:
        """Tell the client that its place goes to another; the connection is closed next."""
        self.leaving = True
        text = f"another client needed the place of this connection; there are {MAX_CONNECTIONS}"
        if not self._writer.is_closing():
            self._writer.write(_refusal_line(text))

    async def run(self) -> None:
        while True:
            try:
                line = await self._reader.readline()
            except ValueError:  # longer than the limit: what follows cannot be told apart
                await self._send({"id": None, "error": _refusal(f"is longer than {MAX_REQUEST_BYTES} bytes")})
                return
            if not line.endswith(b"\n"):
                return
            self.heard, self.answering = time.monotonic(), True
            try:
                await self._answer(line)
            finally:
                self.answering = False

    async def _answer(self, line: bytes) -> None:
        request_id = None
        try:
            request_id, method, params = _parse(line)
            if method == "watch":
                await self._watch(request_id)
                return
            result = await self._call(method, params)
        except Exception as exc:
            if isinstance(exc, ConnectionError | TimeoutError):
                raise
            await self._send({"id": request_id, "error": described(exc)})
        else:
            await self._send({"id": request_id, "result": result})

    async def _call(self, method: str, params: dict[str, Any]) -> Any:
        if method == "status":
            return self._engine.status()
        if method == "live":
            return live(self._engine, Params(method, params))
        if method == "joints":
            return self._engine.joints()
        return await carry_out(self._engine, self._auditor, method, params, Caller(self.who, "control"))

    async def _watch(self, request_id: Any) -> None:
        """Push the status after changes until the client goes away."""
        self.answering, self.watching = False, True
        changed = asyncio.Event()
        unsubscribe = self._engine.subscribe(changed.set)
        closed = asyncio.create_task(self._reader.read(1))
        try:
            while not closed.done():
                changed.clear()
                await self._send({"id": request_id, "event": "status", "data": self._engine.status()})
                await asyncio.wait([closed], timeout=WATCH_PERIOD_S)
                await _first(changed, closed, WATCH_IDLE_S - WATCH_PERIOD_S)
        finally:
            self.watching = False
            unsubscribe()
            closed.cancel()

    async def _send(self, message: dict[str, Any]) -> None:
        """Write one line; a client that does not read is dropped rather than waited for."""
        self._writer.write(json.dumps(message, default=str).encode() + b"\n")
        async with asyncio.timeout(SEND_TIMEOUT_S):
            await self._writer.drain()


async def _first(changed: asyncio.Event, closed: asyncio.Task[bytes], timeout: float) -> None:
    """Wait until something changed, the client closed, or the time is over."""
    change = asyncio.create_task(changed.wait())
    try:
        await asyncio.wait([change, closed], timeout=timeout, return_when=asyncio.FIRST_COMPLETED)
    finally:
        change.cancel()


def _parse(line: bytes) -> tuple[Any, str, dict[str, Any]]:
    try:
        request = json.loads(line)
    except ValueError as exc:
        raise error("ARGUMENT_INVALID", f"the request is not JSON: {exc}") from exc
    except RecursionError as exc:
        raise too_deep() from exc
    check_bounds(request)
    if not isinstance(request, dict) or not isinstance(request.get("method"), str):
        raise error("ARGUMENT_INVALID", "the request is not an object with 'id', 'method' and 'params'")
    params = request.get("params") or {}
    if not isinstance(params, dict):
        raise error("ARGUMENT_INVALID", f"'params' of {request['method']} is not an object")
    return request.get("id"), request["method"], params


def _refusal(what: str) -> dict[str, object]:
    return error("ARGUMENT_INVALID", f"the request {what}").as_dict()


def _refusal_line(text: str) -> bytes:
    """A line that answers no request: why the server closes a connection."""
    return json.dumps({"id": None, "error": error("NOT_NOW", text).as_dict()}).encode() + b"\n"


def peer_name(connection: socket.socket) -> str:
    """Who is at the other end, by the kernel's word (SO_PEERCRED): ``anna (uid 1000)``."""
    raw = connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, struct.calcsize("3i"))
    uid = struct.unpack("3i", raw)[1]
    try:
        return f"{pwd.getpwuid(uid).pw_name} (uid {uid})"
    except KeyError:
        return f"uid {uid}"


async def _refuse_unless_free(path: Path) -> None:
    """Raise unless ``path`` is absent or the leftover of a daemon that is gone."""
    if not _is_socket(path):
        return
    try:
        async with asyncio.timeout(PROBE_TIMEOUT_S):
            _, writer = await asyncio.open_unix_connection(path)
    except (ConnectionRefusedError, FileNotFoundError):
        return
    except TimeoutError:
        pass  # it exists and is listened to, only slowly
    else:
        writer.close()
    raise error("DAEMON_RUNNING", f"one answers on {path}")


def _is_socket(path: Path) -> bool:
    try:
        mode = path.lstat().st_mode
    except FileNotFoundError:
        return False
    if not stat.S_ISSOCK(mode):
        raise error("CONFIG_INVALID", f"[cell] control_socket = {path} exists and is not a socket")
    return True


def _bind(path: Path) -> socket.socket:
    """A listening socket that appears at ``path`` with its final mode, replacing a leftover."""
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_NONBLOCK)
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary.unlink(missing_ok=True)
        listener.bind(str(temporary))
        temporary.chmod(0o660)
        listener.listen(16)
        temporary.replace(path)
    except OSError as exc:
        listener.close()
        reason = exc.strerror or str(exc)
        if exc.errno is None or exc.errno == errno.ENAMETOOLONG:
            reason = "the path is longer than the 107 bytes a unix socket can have"
        raise error("CONFIG_INVALID", f"[cell] control_socket = {path} cannot be made: {reason}") from exc
    return listener
