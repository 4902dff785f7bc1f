"""Runs that the broker has not got yet. The run folders are the queue: what ended is kept there anyway.

A file beside them names the last run that the broker has acknowledged, so nothing is lost while the broker or
the daemon is away, however long, and no second store fills the disk. A run may come twice, never not at all.
"""

import logging
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from cell.errors import CellError
from cell.store.files import read_json, to_json, write_atomic
from cell.store.runs import list_runs
from daemon.mqtt.messages import run_message

log = logging.getLogger("cellward.mqtt")
FILE, SCHEMA = "mqtt.json", "cellward.mqtt/1"
_FIRST = 16


class Outbox:
    """Not for the event loop: every method reads or writes files."""

    def __init__(self, state: Path) -> None:
        self._runs = state / "runs"
        self._file = state / FILE
        self._acknowledged: int | None = None

    def waiting(self) -> Iterator[tuple[int, dict[str, Any]]]:
        """Number and message of each run after the last acknowledged one, oldest first."""
        last = self._last()
        count = _FIRST
        while len(folders := list_runs(self._runs, count)) == count and folders[0].run_id > last:
            count *= 4
        for folder in folders:
            if folder.run_id <= last:
                continue
            try:
                end = folder.read_end()
                if end is None:
                    return  # it runs, or waits to be marked as interrupted: the order is kept
                yield folder.run_id, run_message(folder, end)
            except CellError as exc:
                log.error("run %d cannot be told to the broker: %s", folder.run_id, exc)

    def acknowledge(self, run_id: int) -> None:
        """The broker has this run and all before it."""
        write_atomic(self._file, to_json({"schema": SCHEMA, "run_id": run_id}) + "\n")
        self._acknowledged = run_id

    def _last(self) -> int:
        if self._acknowledged is None:
            try:
                self._acknowledged = int(read_json(self._file)["run_id"]) if self._file.exists() else 0
            except (CellError, KeyError, TypeError, ValueError) as exc:
                log.warning("%s cannot be read (%s): all runs are told anew", self._file, exc)
                self._acknowledged = 0
        return self._acknowledged
