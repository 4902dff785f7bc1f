"""Reads a recording, whoever's program wrote it, and says where it cannot be one."""

import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from cell.errors import CellError, error
from cell.wire_recording.layout import LONGEST, MAGIC, RECORD, VERSION, Kind


@dataclass(frozen=True)
class Record:
    """Bytes that went over a connection at ``t``, monotonic s of the recording computer."""

    t: float
    sent: bool
    data: bytes


@dataclass
class Connection:
    """One connection from its opening on; ``closed`` None: it was open at the end of the recording."""

    protocol: str
    peer: str
    opened: float
    closed: float | None = None
    records: list[Record] = field(default_factory=list)


@dataclass
class WireRecording:
    """Connections by the time at which they were opened; ``left_out``: what the writer says is missing."""

    connections: list[Connection]
    left_out: list[str]

    def of(self, protocol: str) -> list[Connection]:
        """The connections of one protocol."""
        return [one for one in self.connections if one.protocol == protocol]

    @property
    def begin(self) -> float:
        """Time of the first connection, monotonic s; 0 for an empty recording."""
        return self.connections[0].opened if self.connections else 0.0


def read_recording(folder: Path) -> WireRecording:
    """All of a recording. ``ARGUMENT_INVALID`` names the segment and the place of what is no record.

    The last record of the last segment may be cut off, as of a computer that lost its power: it is left out.
    """
    segments = sorted(folder.glob("wire-*.bin"))
    if not segments:
        raise error("ARGUMENT_INVALID", f"{folder} holds no recording (no file wire-*.bin)")
    open_now: dict[int, Connection] = {}
    connections: list[Connection] = []
    left_out: list[str] = []
    for path in segments:
        for kind, channel, t, body in _records(path, last=path == segments[-1]):
            if kind is Kind.HEADER:
                if dropped := _json(path, body).get("dropped_segments"):
                    left_out = [f"{dropped} segments before {path.name} were dropped to keep to the limit"]
            elif kind is Kind.OPENED:
                if channel not in open_now:
                    told = _json(path, body)
                    open_now[channel] = one = Connection(str(told["protocol"]), str(told["peer"]), t)
                    connections.append(one)
            elif kind is Kind.LEFT_OUT:
                left_out.append(f"{_json(path, body)['bytes']} bytes at {t:.3f} s: the disk was too slow")
            elif channel not in open_now:
                raise _damaged(path, f"a record of channel {channel}, which is not open")
            elif kind is Kind.CLOSED:
                open_now.pop(channel).closed = t
            else:
                open_now[channel].records.append(Record(t, kind is Kind.SENT, body))
    return WireRecording(connections, left_out)


def _records(path: Path, last: bool) -> Iterator[tuple[Kind, int, float, bytes]]:
    data = path.read_bytes()
    if not data.startswith(MAGIC):
        raise _damaged(path, f"it does not begin with {MAGIC!r}")
    at = len(MAGIC)
    while at < len(data):
        cut = len(data) - at < RECORD.size
        number, channel, t, length = (0, 0, 0.0, 0) if cut else RECORD.unpack_from(data, at)
        if length > LONGEST or number not in tuple(Kind):
            raise _damaged(path, f"no record at byte {at} (kind {number}, {length} bytes)")
        begin = at + RECORD.size
        if cut or len(data) - begin < length:
            if last:
                return
            raise _damaged(path, f"the record at byte {at} is cut off")
        at = begin + length
        kind = Kind(number)
        body = data[begin:at]
        if kind is Kind.HEADER and (version := _json(path, body).get("version")) != VERSION:
            raise _damaged(path, f"it has version {version}, and this program reads {VERSION}")
        yield kind, channel, t, body


def _json(path: Path, body: bytes) -> dict[str, Any]:
    try:
        return dict(json.loads(body))
    except (ValueError, TypeError) as exc:
        raise _damaged(path, f"{body[:40]!r} is no JSON object") from exc


def _damaged(path: Path, what: str) -> CellError:
    return error("ARGUMENT_INVALID", f"{path} is no segment of a recording: {what}")
