"""The client of the control socket: synchronous and light, because the command line waits for its import."""

import json
import socket
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from cell.errors import CellError, catalogue, error

CALL_TIMEOUT_S = 10.0
WATCH_TIMEOUT_S = 10.0  # the server says something at least every two seconds


class ControlClient:
    """One connection to the daemon. ``with ControlClient(path) as daemon: daemon.call("status")``."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._requests = 0
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._socket.settimeout(CALL_TIMEOUT_S)
        try:
            self._socket.connect(str(path))
        except PermissionError as exc:
            self._socket.close()
            raise error("ACCESS_DENIED", f"{path}: {exc.strerror or exc}") from exc
        except OSError as exc:
            self._socket.close()
            raise error("DAEMON_UNREACHABLE", f"{path}: {exc.strerror or exc}") from exc
        self._lines = self._socket.makefile("rb")

    def call(self, method: str, timeout: float = CALL_TIMEOUT_S, **params: Any) -> Any:
        """The result of one request; the daemon's refusal is raised as its own ``CellError``."""
        self._ask(method, timeout, params)
        return self._reply()["result"]

    def watch(self) -> Iterator[dict[str, Any]]:
        """The status now and after every change, until the daemon goes away."""
        self._ask("watch", WATCH_TIMEOUT_S, {})
        while True:
            yield self._reply()["data"]

    def close(self) -> None:
        self._lines.close()
        self._socket.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, exc: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _ask(self, method: str, timeout: float, params: dict[str, Any]) -> None:
        self._requests += 1
        self._socket.settimeout(timeout)
        request = {"id": self._requests, "method": method, "params": params}
        try:
            self._socket.sendall(json.dumps(request).encode() + b"\n")
        except BrokenPipeError:
            return  # closed by the daemon, which may have said why: that line is what the reply reads
        except OSError as exc:
            raise error("DAEMON_UNREACHABLE", f"{self.path}: {exc.strerror or exc}") from exc

    def _reply(self) -> dict[str, Any]:
        try:
            line = self._lines.readline()
        except TimeoutError as exc:
            waited = self._socket.gettimeout()
            raise error("DAEMON_UNREACHABLE", f"{self.path}: no answer in {waited:g} s") from exc
        except OSError as exc:
            raise error("DAEMON_UNREACHABLE", f"{self.path}: {exc.strerror or exc}") from exc
        if not line.endswith(b"\n"):
            raise error("DAEMON_UNREACHABLE", f"{self.path}: the daemon closed the connection")
        reply: dict[str, Any] = json.loads(line)
        if "error" in reply:
            raise _as_raised(reply["error"])
        return reply


def _as_raised(described: dict[str, Any]) -> CellError:
    """The error that the daemon raised, of the same class and with the same text."""
    entry = catalogue().get(described["name"])
    if entry is None:  # a newer daemon
        return error("INTERNAL", f"{described['text']} ({described['code']})")
    return error(entry.name, described["text"].removeprefix(entry.text).removeprefix(": "))
