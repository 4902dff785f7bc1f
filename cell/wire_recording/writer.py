"""Writes a recording: a driver only appends to a list, a thread of its own waits for the disk.

What is on the disk is bounded: beyond ``limit_bytes`` the oldest segment goes. What waits for a slow disk is
bounded, too: what is beyond is left out. Both are written down in the recording and logged once. A disk that
fails ends the recording and nothing else.
"""

import json
import logging
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from cell.errors import error
from cell.wire_recording.layout import LONGEST, MAGIC, RECORD, VERSION, Kind, segment_name

log = logging.getLogger("cellward.recording")

WRITE_PERIOD_S = 0.2
_MOST_WAITING = 32 << 20
_LARGEST_SEGMENT = 64 << 20
_SEGMENTS = 16  # that make up the limit, so that dropping one drops little


class WireRecorder:
    """``cell.wire_recording.tap.Recorder`` into ``folder``, which must not hold a recording.

    ``bounded_with``: the folder whose recordings share the limit; ``folder`` itself when it is absent.
    ``ARGUMENT_INVALID`` when the folder holds a recording or cannot be written.
    """

    def __init__(
        self,
        folder: Path,
        limit_bytes: int,
        bounded_with: Path | None = None,
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        self.folder, self._limit, self._now = folder, limit_bytes, now
        self._segment_bytes = min(limit_bytes // _SEGMENTS, _LARGEST_SEGMENT)
        self._root = bounded_with or folder
        self._lock = threading.Lock()
        self._waiting: list[bytes] = []
        self._waiting_bytes = self._left_out = 0
        self._dropped_segments = self._next_channel = self._segment = 0
        self._open: dict[int, bytes] = {}
        self._failed = False
        self._stop = threading.Event()
        try:
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            if any(folder.glob("wire-*.bin")):
                raise error("ARGUMENT_INVALID", f"{folder} holds a recording already; name another folder")
            self._file = self._next_segment()
        except OSError as exc:
            raise error("ARGUMENT_INVALID", f"{folder} cannot take a recording: {exc}") from exc
        self._thread = threading.Thread(target=self._run, name="wire recording", daemon=True)
        self._thread.start()

    def channel(self, protocol: str, peer: str) -> "_Channel":
        """A new channel; one for each connection."""
        told = json.dumps({"protocol": protocol, "peer": peer}).encode()
        with self._lock:
            number = self._next_channel = self._next_channel + 1
            self._open[number] = told
        self.add(Kind.OPENED, number, told, None)
        return _Channel(self, number)

    def add(self, kind: Kind, channel: int, data: bytes, t: float | None) -> None:
        """Append a record; costs about a microsecond and never waits for the disk."""
        head = RECORD.pack(kind, channel, self._now() if t is None else t, len(data))
        with self._lock:
            if kind is Kind.CLOSED:
                self._open.pop(channel, None)
            if self._failed:
                return
            if self._waiting_bytes > _MOST_WAITING or len(data) > LONGEST:
                self._left_out += len(data)
                return
            self._waiting += (head, data)
            self._waiting_bytes += len(head) + len(data)

    def close(self) -> None:
        """Write what waits and end; harmless when it has ended."""
        self._stop.set()
        self._thread.join(5.0)

    # -- the thread

    def _run(self) -> None:
        try:
            while not self._stop.wait(WRITE_PERIOD_S):
                self._write()
            self._write()
        except OSError as exc:
            with self._lock:
                self._failed, self._waiting = True, []
            log.error("the recording in %s ends here: %s", self.folder, exc)
        finally:
            self._file.close()

    def _write(self) -> None:
        with self._lock:
            waiting, self._waiting, self._waiting_bytes = self._waiting, [], 0
            left_out, self._left_out = self._left_out, 0
        if left_out:
            log.warning("the disk is too slow for the recording: %d bytes are left out of it", left_out)
            waiting += self._note(Kind.LEFT_OUT, {"bytes": left_out})
        if not waiting:
            return
        self._file.write(b"".join(waiting))
        self._file.flush()
        if self._file.tell() >= self._segment_bytes:
            self._file.close()
            self._file = self._next_segment()

    def _next_segment(self) -> Any:
        self._drop_oldest()
        self._segment += 1
        file = (self.folder / segment_name(self._segment)).open("xb")
        with self._lock:
            still_open = dict(self._open)
        header = {
            "format": "cellward-wire",
            "version": VERSION,
            "segment": self._segment,
            "dropped_segments": self._dropped_segments,
            "unix_time": time.time(),
        }
        t = self._now()
        records = self._note(Kind.HEADER, header)
        for channel, told in still_open.items():
            records += (RECORD.pack(Kind.OPENED, channel, t, len(told)), told)
        file.write(MAGIC + b"".join(records))
        return file

    def _drop_oldest(self) -> None:
        """Make room for one segment more."""
        found = sorted(self._root.rglob("wire-*.bin"), key=lambda path: (path.stat().st_mtime_ns, path.name))
        total = sum(path.stat().st_size for path in found)
        while found and total + self._segment_bytes > self._limit:
            oldest = found.pop(0)
            total -= oldest.stat().st_size
            oldest.unlink()
            if oldest.parent == self.folder:
                if not self._dropped_segments:
                    log.warning("the recording has reached %d MB: its oldest part goes", self._limit // 10**6)
                self._dropped_segments += 1

    def _note(self, kind: Kind, what: dict[str, Any]) -> list[bytes]:
        body = json.dumps(what).encode()
        return [RECORD.pack(kind, 0, self._now(), len(body)), body]


class _Channel:
    """``cell.wire_recording.tap.Tap`` of a connection."""

    def __init__(self, recorder: WireRecorder, number: int) -> None:
        self._recorder, self._number, self._is_open = recorder, number, True

    def received(self, data: bytes, t: float | None = None) -> None:
        self._recorder.add(Kind.RECEIVED, self._number, data, t)

    def sent(self, data: bytes, t: float | None = None) -> None:
        self._recorder.add(Kind.SENT, self._number, data, t)

    def closed(self) -> None:
        if self._is_open:
            self._is_open = False
            self._recorder.add(Kind.CLOSED, self._number, b"", None)
