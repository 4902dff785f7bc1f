"""Joints from a file to which the arm's program or its operator adds a row at each rest."""

import asyncio
import logging
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from cell.clock import Clock
from cell.devices import Identity
from cell.errors import CellError, error
from cell.poses import Array
from drivers.modbus.link import NoAnswer
from drivers.observed_arm.config import ObservedArmConfig
from drivers.observed_arm.joint_source import ObservedJoints
from drivers.observed_arm.rows import MAX_BYTES, BadRow, JointTable, TableChanged, TableFormat

log = logging.getLogger("cellward.devices")

T = TypeVar("T")
Stamp = tuple[int, int, int]  # size, time of change, file number


class FileSource:
    """Each new row is an event: the arm came to rest there between this look at the file and the one before.

    Rows that are there at opening are the past. A file that does not grow is not stale; only one that cannot
    be read, or whose old rows changed, ends the link. The file may be on a network drive that hangs: it is
    looked at in a thread, with a time-out.
    """

    def __init__(self, name: str, config: ObservedArmConfig, clock: Clock) -> None:
        self._name, self._config, self._clock = name, config, clock
        self._path = Path(config.path)
        self._table = JointTable(config.columns, [joint.encoding for joint in config.joints])
        self._stamp: Stamp = (0, 0, 0)
        self._before = 0.0  # when the look before began
        self._old = self._rows = self._rejected = 0
        self._last_rejected = ""

    async def open(self) -> Identity:
        """``DEVICE_UNREACHABLE`` without the file, ``OBSERVED_FILE_FORMAT`` for another table."""
        self._before = self._clock.now()
        try:
            self._stamp, data = await self._in_time(_read, self._path)
        except NoAnswer as exc:
            raise error("DEVICE_UNREACHABLE", f"{self._name}: {exc}") from exc
        try:
            self._old = self._table.begin(data)
        except TableFormat as exc:
            raise error("OBSERVED_FILE_FORMAT", f"{self._name}: {self._path}: {exc}") from exc
        return Identity(self._config.model, self._table.serial or self._config.stated_serial or "")

    async def close(self) -> None:
        """Nothing stays open between two looks."""

    async def look(self, tick: int) -> list[ObservedJoints]:
        begin = self._clock.now()
        self._stamp, data = await self._in_time(_read_changed, self._path, self._stamp)
        end = self._clock.now()
        since, self._before = self._before, begin
        if data is None:
            return []
        try:
            rows = self._table.read(data)
        except TableChanged:
            raise error(
                "OBSERVED_FILE_CHANGED", f"{self._name}: rows of {self._path} that were read are not the same"
            ) from None
        out: list[ObservedJoints] = []
        middle = 0.5 * (since + end) - self._config.time_offset_s
        for row in rows:
            if isinstance(row, BadRow):
                self._reject(row)
            else:
                q, seq = np.array(row.q), self._rows
                self._rows += 1
                out.append(ObservedJoints(q, middle, 0.5 * (end - since), seq, rests=True, pose=row.pose))
        return out

    async def request(self, number: int, q: Array) -> bool:
        """There is nobody to ask but a person."""
        return False

    def health(self) -> dict[str, Any]:
        return {
            "rows_before": self._old,
            "rows": self._rows,
            "rejected": self._rejected,
            "last_rejected": self._last_rejected,
            "unfinished_line": self._table.unfinished,
        }

    def _reject(self, row: BadRow) -> None:
        self._rejected += 1
        self._last_rejected = f"line {row.number}: {row.why}"
        log.warning("%s: %s line %d is not used: %s", self._name, self._path, row.number, row.why)

    async def _in_time(self, read: Callable[..., T], *args: Any) -> T:
        """What ``read`` finds; ``NoAnswer`` when it does not, or not in time."""
        try:
            async with asyncio.timeout(self._config.timeout_s):
                return await asyncio.to_thread(read, *args)
        except TimeoutError:
            raise NoAnswer(f"{self._path} was not read in {self._config.timeout_s:g} s") from None
        except CellError:
            raise
        except OSError as exc:
            raise NoAnswer(f"{self._path}: {exc.strerror or exc}") from exc


def _read(path: Path) -> tuple[Stamp, bytes]:
    """The file; its stamp was taken before, so that nothing is missed."""
    info = os.stat(path)
    if info.st_size > MAX_BYTES:
        raise error("OBSERVED_FILE_FORMAT", f"{path} has more than {MAX_BYTES} bytes; begin a new one")
    with path.open("rb") as file:
        return _stamp(info), file.read(MAX_BYTES + 1)


def _read_changed(path: Path, before: Stamp) -> tuple[Stamp, bytes | None]:
    """The file when it is not as it was ``before``, else None."""
    return (before, None) if _stamp(os.stat(path)) == before else _read(path)


def _stamp(info: os.stat_result) -> Stamp:
    return info.st_size, info.st_mtime_ns, info.st_ino
