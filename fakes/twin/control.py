"""The twin's control socket: one JSON line asks, one answers. Its folder belongs to the user alone."""

import asyncio
import json
import os
import socket
import tempfile
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

from cell.errors import CellError, error

SOCKET_NAME = "twin.sock"
TIMEOUT_S = 5.0
LINE_LIMIT = 1 << 20
Request = dict[str, Any]
Handler = Callable[[Request], Awaitable[Any]]


def default_folder() -> Path:
    """Where a twin keeps its files unless told otherwise: one folder per user."""
    return Path(tempfile.gettempdir()) / f"cellward-twin-{os.getuid()}"


def make_private(folder: Path) -> None:
    """Create ``folder`` for its owner alone; ``NOT_ALLOWED`` when it is somebody else's."""
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    if folder.stat().st_uid != os.getuid():
        raise error("NOT_ALLOWED", f"{folder} belongs to another user; choose another with --out")


async def serve_control(folder: Path, handle: Handler) -> asyncio.Server:
    """Listen in ``folder``; ``NOT_NOW`` when a twin already runs there."""
    path = folder / SOCKET_NAME
    if path.exists():
        if _answers(path):
            raise error("NOT_NOW", f"a twin already runs in {folder}; stop it or choose another --out")
        path.unlink()

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            async with asyncio.timeout(TIMEOUT_S):
                line = await reader.readline()
                writer.write(json.dumps(await _answer(line, handle)).encode() + b"\n")
                await writer.drain()
        except (OSError, TimeoutError, ValueError):
            pass  # the asker went away or asked nothing
        finally:
            writer.close()

    return await asyncio.start_unix_server(serve, path, limit=LINE_LIMIT)


async def _answer(line: bytes, handle: Handler) -> dict[str, Any]:
    try:
        request = json.loads(line)
        if not isinstance(request, dict):
            raise error("ARGUMENT_INVALID", "a request is a JSON object")
        return {"ok": True, "value": await handle(request)}
    except CellError as exc:
        return {"ok": False, "name": exc.name, "detail": exc.detail}
    except ValueError as exc:
        return {"ok": False, "name": "ARGUMENT_INVALID", "detail": str(exc)}


def ask(folder: Path, request: Request) -> Any:
    """Ask the twin that runs in ``folder``; ``DEVICE_UNREACHABLE`` when there is none."""
    path = folder / SOCKET_NAME
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as link:
        link.settimeout(TIMEOUT_S)
        try:
            link.connect(str(path))
            link.sendall(json.dumps(request).encode() + b"\n")
            with link.makefile("rb") as stream:
                reply = json.loads(stream.readline(LINE_LIMIT))
        except (OSError, ValueError) as exc:
            failure = error("DEVICE_UNREACHABLE", f"no twin answers in {folder}: {exc}")
            failure.hint = (
                "Start one with 'cellward-twin --scenario NAME', or give the folder of yours with --out."
            )
            raise failure from exc
    if not reply["ok"]:
        raise error(reply["name"], reply["detail"])
    return reply["value"]


def _answers(path: Path) -> bool:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as link:
        link.settimeout(0.5)
        try:
            link.connect(str(path))
        except OSError:
            return False
        return True
