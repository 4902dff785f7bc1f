"""A table of rest poses that grows at its end: a header, then one row for each rest.

``#`` begins a comment; ``# serial: 123`` before the header says whose joints these are. Fields are separated
by the first of ``;``, tab or ``,`` that the header has. A row counts once its line is ended.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite

from drivers.observed_arm.numbers import Encoding

MAX_BYTES = 16 * 2**20
MAX_POSE = 0xFFFF


class TableChanged(Exception):
    """What had been read already is not the same any more."""


class TableFormat(Exception):
    """The table does not have the columns that it should have."""


@dataclass(frozen=True)
class JointRow:
    """``number`` counts the lines of the file from 1; ``q`` in rad or m."""

    number: int
    q: tuple[float, ...]
    pose: int | None


@dataclass(frozen=True)
class BadRow:
    """A row that cannot be used, and why."""

    number: int
    why: str


class JointTable:
    """``begin`` reads what is there as the past; each ``read`` gives the rows that were added since."""

    def __init__(self, columns: Sequence[str], encodings: Sequence[Encoding]) -> None:
        self._columns, self._encodings = list(columns), list(encodings)
        self.serial = ""
        self.unfinished = False
        self._size, self._digest, self._lines = 0, b"", 0
        self._separator, self._header = ",", [""]
        self._t: float | None = None

    def begin(self, data: bytes) -> int:
        """Take the header and all rows so far as old; returns their number. :class:`TableFormat`."""
        self.serial, self._header = "", []
        self._size, self._lines, self._t = 0, 0, None
        old = self._take(data)
        if not self._header:
            raise TableFormat(f"it has no header; its first line should be {','.join(self._columns)}")
        return len(old)

    def read(self, data: bytes) -> list[JointRow | BadRow]:
        """Rows that are new in ``data``, the whole file; :class:`TableChanged` if it did not just grow."""
        if hashlib.sha256(data[: self._size]).digest() != self._digest:
            raise TableChanged
        return self._take(data)

    def _take(self, data: bytes) -> list[JointRow | BadRow]:
        end = data.rfind(b"\n") + 1
        self.unfinished = end < len(data)
        fresh = data[self._size : end] if end > self._size else b""
        out: list[JointRow | BadRow] = []
        for line in fresh.decode("utf-8", "replace").removeprefix("\ufeff").split("\n")[:-1]:
            self._lines += 1
            text = line.strip()
            if text.startswith("#"):
                self._comment(text[1:])
            elif text and not self._header:
                self._head(text)
            elif text:
                out.append(self._row(text))
        self._size = max(self._size, end)
        self._digest = hashlib.sha256(data[: self._size]).digest()
        return out

    def _comment(self, text: str) -> None:
        key, colon, value = text.partition(":")
        if colon and key.strip().lower() == "serial" and not self._header:
            self.serial = value.strip()

    def _head(self, text: str) -> None:
        self._separator = next((mark for mark in ";\t," if mark in text), ",")
        header = [name.strip() for name in text.split(self._separator)]
        if missing := [name for name in self._columns if name not in header]:
            raise TableFormat(f"its header {text!r} has no column {', '.join(missing)}")
        if len(set(header)) != len(header):
            raise TableFormat(f"its header {text!r} names a column twice")
        self._header = header

    def _row(self, text: str) -> JointRow | BadRow:
        fields = [field.strip() for field in text.split(self._separator)]
        try:
            if len(fields) != len(self._header):
                raise ValueError(f"it has {len(fields)} fields, the header {len(self._header)}")
            named = dict(zip(self._header, fields, strict=True))
            numbers = [_number(named, column) for column in self._columns]
            self._look_at_time(named)
            pose = _pose(named)
        except ValueError as exc:
            return BadRow(self._lines, str(exc))
        q = tuple(e.joint(x) for e, x in zip(self._encodings, numbers, strict=True))
        return JointRow(self._lines, q, pose)

    def _look_at_time(self, named: dict[str, str]) -> None:
        """The writer's clock is not ours, but its times must go on."""
        if named.get("t"):
            t = _number(named, "t")
            if self._t is not None and t <= self._t:
                raise ValueError(f"its t = {t:g} is not after the {self._t:g} before it")
            self._t = t


def _number(named: dict[str, str], column: str) -> float:
    try:
        value = float(named[column])
    except ValueError:
        raise ValueError(f"{column} = {named[column]!r} is no number") from None
    if not isfinite(value):
        raise ValueError(f"{column} = {named[column]!r} is no finite number")
    return value


def _pose(named: dict[str, str]) -> int | None:
    text = named.get("pose", "")
    if not text:
        return None
    if not (text.isascii() and text.isdecimal() and 0 < int(text) <= MAX_POSE):
        raise ValueError(f"pose = {text!r} is no number from 1 to {MAX_POSE}")
    return int(text)
