"""The control socket: how the command line and the web page talk to the running daemon.

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
from collections.abc import Awaitable, Callable, Mapping
from pathlib import Path
from typing import Any, Protocol

from cell.errors import CellError, error
from daemon.auditor import Audit, Auditor
from daemon.start_request import StartRequest

log = logging.getLogger("cellward.control")

MAX_REQUEST_BYTES = 1 << 20
WATCH_PERIOD_S = 0.2  # status events come at most this often ...
WATCH_IDLE_S = 2.0  # ... and at least this often, so that a reader can tell quiet from dead
SEND_TIMEOUT_S = 5.0
STOP_TIMEOUT_S = 2.0
PROBE_TIMEOUT_S = 1.0
MAX_AUDITED_CHARS = 500
MAX_CONNECTIONS = 64
MAX_DEPTH = 16
MAX_NUMBER = 2**63 - 1  # as the ledger's columns hold it


class EngineControl(Protocol):
    """What the socket needs of the job engine. All refusals are ``CellError``."""

    def status(self) -> dict[str, Any]: ...
    def live(self, since: Mapping[str, int]) -> dict[str, Any]: ...
    async def start(self, request: StartRequest) -> dict[str, Any]: ...
    async def confirm(self, prompt_id: int, who: str) -> None: ...
    async def finish(self, who: str) -> None: ...
    async def abort(self, who: str) -> None: ...
    async def halt(self, who: str) -> None: ...
    async def pause(self, who: str) -> None: ...
    async def resume(self, who: str) -> None: ...
    async def reset(self, who: str) -> None: ...
    async def accept(self, result_id: int, who: str, warned: bool = False) -> dict[str, Any]: ...
    async def reject(self, result_id: int, who: str, why: str) -> dict[str, Any]: ...
    async def rollback(self, name: str, who: str) -> dict[str, Any]: ...
    async def acknowledge_ledger(self) -> dict[str, Any]: ...
    def subscribe(self, listener: Callable[[], None], /) -> Callable[[], None]: ...


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
            await self._send({"id": request_id, "error": _described(exc)})
        else:
            await self._send({"id": request_id, "result": result})

    async def _call(self, method: str, params: dict[str, Any]) -> Any:
        if method == "status":
            return self._engine.status()
        if method == "live":
            return self._engine.live(_numbers(_Params(method, params).get("since", dict, {})))
        handler = _WRITES.get(method)
        if handler is None:
            raise error("ARGUMENT_INVALID", f"the control socket has no method '{method}'")
        what = _audited(method, params)
        try:
            result = await handler(self._engine, _Params(method, params), self.who)
        except BaseException as exc:  # a write that the daemon's end cuts short is told, too
            self._auditor.note(self.who, what, False, str(exc) or type(exc).__name__)
            raise
        self._auditor.note(self.who, what, True)
        return result

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


class _Params:
    """Checked access to the parameters of one request."""

    def __init__(self, method: str, raw: dict[str, Any]) -> None:
        self._method, self._raw = method, raw

    def get(self, name: str, kind: type, default: Any = None) -> Any:
        """The parameter or its default; ``ARGUMENT_INVALID`` when it is missing or of another kind."""
        value = self._raw.get(name)
        if value is None:
            value = default
        if value is None:
            raise error("ARGUMENT_INVALID", f"{self._method} needs '{name}'")
        if type(value) is not kind:
            raise error("ARGUMENT_INVALID", f"{self._method}: '{name}' is not of type {kind.__name__}")
        return value


def _numbers(raw: dict[str, Any]) -> dict[str, int]:
    if not all(type(number) is int for number in raw.values()):
        raise error("ARGUMENT_INVALID", "live: 'since' has a row number for each trace")
    return raw


async def _start(engine: EngineControl, params: _Params, who: str) -> dict[str, Any]:
    adopt = params.get("adopt", int, 0)
    request = StartRequest(
        params.get("job", str),
        {str(k): str(v) for k, v in params.get("params", dict, {}).items()},
        who,
        "control",
        params.get("dry_run", bool, False),
        adopt or None,
    )
    return await engine.start(request)


_WRITES: dict[str, Callable[[EngineControl, _Params, str], Awaitable[Any]]] = {
    "start": _start,
    "confirm": lambda engine, params, who: engine.confirm(params.get("prompt_id", int), who),
    "finish": lambda engine, params, who: engine.finish(who),
    "abort": lambda engine, params, who: engine.abort(who),
    "halt": lambda engine, params, who: engine.halt(who),
    "pause": lambda engine, params, who: engine.pause(who),
    "resume": lambda engine, params, who: engine.resume(who),
    "reset": lambda engine, params, who: engine.reset(who),
    "accept": lambda engine, params, who: _brief(
        engine.accept(params.get("result_id", int), who, params.get("warned", bool, False))
    ),
    "reject": lambda engine, params, who: _brief(
        engine.reject(params.get("result_id", int), who, params.get("why", str, ""))
    ),
    "acknowledge_ledger": lambda engine, params, who: engine.acknowledge_ledger(),
    "rollback": lambda engine, params, who: _brief(engine.rollback(params.get("name", str), who)),
}


async def _brief(decision: Awaitable[dict[str, Any]]) -> dict[str, Any]:
    """What was decided, without documents: a reference of megabytes would hold up the loop for its reply."""
    entry = await decision
    return {k: v for k, v in entry.items() if k != "result" and not isinstance(v, dict)}


def _audited(method: str, params: dict[str, Any]) -> str:
    """A write as one bounded line of text."""
    text = f"{method} {json.dumps(params)}" if params else method
    return text if len(text) <= MAX_AUDITED_CHARS else f"{text[:MAX_AUDITED_CHARS]}..."


def _parse(line: bytes) -> tuple[Any, str, dict[str, Any]]:
    try:
        request = json.loads(line)
    except ValueError as exc:
        raise error("ARGUMENT_INVALID", f"the request is not JSON: {exc}") from exc
    except RecursionError as exc:
        raise _too_deep() from exc
    _check_bounds(request)
    if not isinstance(request, dict) or not isinstance(request.get("method"), str):
        raise error("ARGUMENT_INVALID", "the request is not an object with 'id', 'method' and 'params'")
    params = request.get("params") or {}
    if not isinstance(params, dict):
        raise error("ARGUMENT_INVALID", f"'params' of {request['method']} is not an object")
    return request.get("id"), request["method"], params


def _check_bounds(value: Any, depth: int = 0) -> None:
    """Refuse what the ledger or an answer could not hold: nesting, numbers and text beyond theirs."""
    if depth > MAX_DEPTH:
        raise _too_deep()
    if isinstance(value, dict):
        for key, inner in value.items():
            _check_bounds(key, depth + 1)
            _check_bounds(inner, depth + 1)
    elif isinstance(value, list):
        for inner in value:
            _check_bounds(inner, depth + 1)
    elif isinstance(value, str):
        try:
            value.encode()
        except UnicodeEncodeError as exc:
            raise error("ARGUMENT_INVALID", "the request holds text that is not valid Unicode") from exc
    elif isinstance(value, int | float) and not -MAX_NUMBER <= value <= MAX_NUMBER:
        raise error("ARGUMENT_INVALID", "the request holds a number beyond 2**63 - 1, or not a number")


def _too_deep() -> CellError:
    return error("ARGUMENT_INVALID", f"the request is nested deeper than {MAX_DEPTH}")


def _refusal(what: str) -> dict[str, object]:
    return error("ARGUMENT_INVALID", f"the request {what}").as_dict()


def _refusal_line(text: str) -> bytes:
    """A line that answers no request: why the server closes a connection."""
    return json.dumps({"id": None, "error": error("NOT_NOW", text).as_dict()}).encode() + b"\n"


def _described(exc: Exception) -> dict[str, object]:
    if isinstance(exc, CellError):
        return exc.as_dict()
    log.error("a request failed in an unexpected way", exc_info=exc)
    return error("INTERNAL", f"{type(exc).__name__}: {exc}").as_dict()


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
