"""The journal of a run: one JSON line an event, readable to the last whole line after a kill.

Lines are ``{"seq", "t", "kind", ...}`` with ``t`` in CLOCK_MONOTONIC seconds. The first line is the header;
it carries the wall time, so that the other lines need none. A journal that is opened again gets another
header, because the monotonic axis of the new process may have another origin.
"""

import json
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, Any

from cell.errors import error
from cell.store.files import AppendFile, contents, disk_errors, to_json

if TYPE_CHECKING:
    from cell.clock import Clock

SCHEMA = "cellward.journal/1"
KINDS = frozenset({"state", "decision", "device", "motion", "operator", "solve", "error"})
RESERVED = frozenset({"seq", "t", "kind"})


class Journal:
    """Append-only; a line is in the page cache when ``append`` returns, so a killed process loses none."""

    def __init__(self, path: Path, clock: "Clock", wall: Callable[[], float]) -> None:
        """Begin ``path``, or continue it behind its last whole line. ``wall`` gives seconds since 1970."""
        self.path, self._clock = path, clock
        self._lock = Lock()
        with disk_errors(path):
            lines, end = _scan(contents(path)) if path.exists() else ([], 0)
        self._seq = 1 + max((int(line["seq"]) for line in lines), default=-1)
        self._file = AppendFile(path, keep=end)
        stamp = datetime.fromtimestamp(wall(), UTC).isoformat(timespec="milliseconds")
        self._write("header", False, {"schema": SCHEMA, "wall": stamp})

    def append(self, kind: str, fsync: bool = False, **fields: Any) -> None:
        """One line. ``fsync`` waits for the disk: not on an event loop."""
        if kind not in KINDS or RESERVED & fields.keys():
            raise error("INTERNAL", f"journal line of kind '{kind}' with fields {sorted(fields)}")
        self._write(kind, fsync, fields)

    def check_on_disk(self) -> None:
        """``RUN_FOLDER_LOST`` when the file was removed or moved: what is written to it is lost."""
        if not self._file.in_place():
            raise error("RUN_FOLDER_LOST", f"{self.path} was removed or moved while the run went on")

    def sync(self) -> None:
        """All lines are on the disk when this returns."""
        self._file.sync()

    def close(self) -> None:
        self._file.close()

    def _write(self, kind: str, fsync: bool, fields: dict[str, Any]) -> None:
        with self._lock:
            entry = {"seq": self._seq, "t": round(self._clock.now(), 6), "kind": kind, **fields}
            self._file.append((to_json(entry) + "\n").encode("utf-8"))
            self._seq += 1
            self.check_on_disk()
            if fsync:
                self._file.sync()


def read_journal(path: Path) -> list[dict[str, Any]]:
    """All whole lines; one that is torn or damaged is left out. ``FILE_MISSING`` or ``FILE_UNREADABLE``."""
    try:
        return _scan(contents(path))[0]
    except FileNotFoundError:
        raise error("FILE_MISSING", str(path)) from None
    except OSError as exc:
        raise error("FILE_UNREADABLE", f"{path}: {exc.strerror or exc}") from exc


def _scan(data: bytes) -> tuple[list[dict[str, Any]], int]:
    """The lines that are JSON objects, and the offset behind the last whole line."""
    lines: list[dict[str, Any]] = []
    end = data.rfind(b"\n") + 1
    for raw in data[:end].split(b"\n"):
        try:
            entry = json.loads(raw)
        except ValueError:
            continue
        if isinstance(entry, dict) and isinstance(entry.get("seq"), int):
            lines.append(entry)
    return lines, end
