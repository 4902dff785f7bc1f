"""A small RTDE and primary client for tests, written from the public guides and from nothing of ours."""

import json
import socket
import struct
import subprocess
import sys
import textwrap
from collections.abc import Iterator
from typing import Any

TIMEOUT_S = 5.0


class Rtde:
    """One connection to port 30004; blocking, with a time-out on everything."""

    def __init__(self, host: str, version: int = 2) -> None:
        self._socket = socket.create_connection((host, 30004), TIMEOUT_S)
        self._rest = b""
        self.version = version
        if version == 2:
            assert self.ask("V", struct.pack(">H", 2)) == b"\x01"

    def __enter__(self) -> "Rtde":
        return self

    def __exit__(self, *_: object) -> None:
        self._socket.close()

    def raw(self, data: bytes) -> None:
        self._socket.sendall(data)

    def send(self, kind: str, payload: bytes = b"") -> None:
        self.raw(struct.pack(">HB", 3 + len(payload), ord(kind)) + payload)

    def receive(self) -> tuple[str, bytes]:
        """The next package; ``ConnectionError`` when the controller closed."""
        while True:
            if len(self._rest) >= 3:
                size, kind = struct.unpack_from(">HB", self._rest)
                if len(self._rest) >= size:
                    package, self._rest = self._rest[3:size], self._rest[size:]
                    return chr(kind), package
            data = self._socket.recv(65536)
            if not data:
                raise ConnectionError("closed by the controller")
            self._rest += data

    def next(self, kind: str) -> bytes:
        """The next package of a kind, others are passed over."""
        while True:
            found, payload = self.receive()
            if found == kind:
                return payload

    def ask(self, kind: str, payload: bytes = b"") -> bytes:
        self.send(kind, payload)
        return self.next(kind)

    def outputs(self, names: str, frequency: float = 500.0) -> str:
        """Set up outputs; returns the types as one string."""
        if self.version == 1:
            return self.ask("O", names.encode()).decode()
        return self.ask("O", struct.pack(">d", frequency) + names.encode())[1:].decode()

    def inputs(self, names: str) -> tuple[int, str]:
        """Set up an input recipe; its id and the types."""
        reply = self.ask("I", names.encode())
        return reply[0], reply[1:].decode()

    def start(self) -> bool:
        return self.ask("S") == b"\x01"

    def doubles(self) -> tuple[float, ...]:
        """The next data package of a recipe that has only doubles."""
        data = self.next("U")[1 if self.version == 2 else 0 :]
        return struct.unpack(f">{len(data) // 8}d", data)

    def value(self, layout: str) -> tuple[Any, ...]:
        """The next data package by its struct layout."""
        return struct.unpack(">" + layout, self.next("U")[1:])


class Lines:
    """The dashboard: one line out, one line in."""

    def __init__(self, host: str) -> None:
        self._socket = socket.create_connection((host, 29999), TIMEOUT_S)
        self._stream = self._socket.makefile("rb")
        self.banner = self._stream.readline().decode().strip()

    def __enter__(self) -> "Lines":
        return self

    def __exit__(self, *_: object) -> None:
        self._stream.close()
        self._socket.close()

    def ask(self, line: str) -> str:
        self._socket.sendall(line.encode() + b"\n")
        return self._stream.readline().decode().rstrip("\n")


class Text:
    """The primary (30001) or script (30003) port."""

    def __init__(self, host: str, port: int = 30001) -> None:
        self._socket = socket.create_connection((host, port), TIMEOUT_S)
        self._rest = b""

    def __enter__(self) -> "Text":
        return self

    def __exit__(self, *_: object) -> None:
        self._socket.close()

    def send(self, text: str) -> None:
        self._socket.sendall(text.encode())

    def packages(self) -> Iterator[tuple[int, bytes]]:
        """``(type, body)`` of each primary package."""
        while True:
            while len(self._rest) >= 5:
                size, kind = struct.unpack_from(">iB", self._rest)
                if len(self._rest) < size:
                    break
                body, self._rest = self._rest[5:size], self._rest[size:]
                yield kind, body
            data = self._socket.recv(65536)
            if not data:
                raise ConnectionError("closed by the controller")
            self._rest += data

    def message(self, kind: int) -> bytes:
        """Body of the next robot message of a kind, without stamp and source."""
        for package, body in self.packages():
            if package == 20 and body[9] == kind:
                return body[10:]
        raise ConnectionError

    def state(self) -> dict[int, bytes]:
        """Sub-packages of the next robot state by their number."""
        for package, body in self.packages():
            if package == 16:
                return dict(_sub_packages(body))
        raise ConnectionError


def _sub_packages(body: bytes) -> Iterator[tuple[int, bytes]]:
    while body:
        size, kind = struct.unpack_from(">iB", body)
        yield kind, body[5:size]
        body = body[size:]


def genuine(host: str, code: str, timeout: float = 40.0) -> dict[str, Any]:
    """Run ``code`` with the genuine ur-rtde in a process of its own; it fills ``seen``, which is returned.

    The process leaves by ``os._exit``: destructors of the genuine client can abort it.
    """
    program = (
        "import faulthandler, json, os, sys, time\n"
        "faulthandler.dump_traceback_later(35, exit=True)\n"
        "from rtde_control import RTDEControlInterface\n"
        "from rtde_receive import RTDEReceiveInterface\n"
        "from rtde_io import RTDEIOInterface\n"
        "from dashboard_client import DashboardClient\n"
        f"HOST, seen = {host!r}, {{}}\n"
        # Control and receive are two connections: let the second catch up with the first.
        "def caught_up(r):\n"
        "    until, end = r.getTimestamp() + 0.05, time.monotonic() + 3\n"
        "    while r.getTimestamp() < until and time.monotonic() < end: time.sleep(0.002)\n"
        "    return r\n"
        "def stopped(c, r):\n"
        "    end = time.monotonic() + 5\n"
        "    while time.monotonic() < end and (c.isProgramRunning() or max(map(abs, r.getActualQd())) > 0):\n"
        "        time.sleep(0.01)\n"
        + textwrap.dedent(code)
        + "\nsys.stderr.flush()\nos.write(1, b'\\n@@' + json.dumps(seen).encode())\nos._exit(0)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=timeout, check=False
    )
    assert done.returncode == 0, f"the genuine client ended with {done.returncode}: {done.stderr[-2000:]}"
    result: dict[str, Any] = json.loads(done.stdout.rsplit("@@", 1)[1])
    return result
