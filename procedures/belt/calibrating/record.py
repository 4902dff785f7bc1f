"""The raw data of a belt calibration on disk: counts, sightings and touches as lines, then one data set."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from cell.errors import error
from cell.store.files import AppendFile, read_json, to_json, write_atomic

COUNTS_FILE, SIGHTINGS_FILE, TOUCHES_FILE = "counts.jsonl", "sightings.jsonl", "touches.jsonl"
DATA_FILE = "belt.json"
SCHEMA = "cellward.belt-calibration/1"


class CalibrationRecord:
    """What one run has seen. :meth:`flush` and :meth:`write_data_set` block on the disk: call in a thread.

    Counts are ``[t, count, raw]``; sightings ``{"t", "seq", "points", "sigma_m"}`` with the points (k, 3) in
    the camera, m; touches ``{"t", "count", "point"}`` with the tool's point (3,) in the base, m.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.counts: list[tuple[float, int, int]] = []
        self.sightings: list[dict[str, Any]] = []
        self.touches: list[dict[str, Any]] = []
        self.begins: list[float] = []  # times from which the encoder counted anew, s
        self._written = {COUNTS_FILE: 0, SIGHTINGS_FILE: 0, TOUCHES_FILE: 0}

    def flush(self) -> None:
        """What is new goes to disk."""
        rows: tuple[tuple[str, Sequence[Any]], ...] = (
            (COUNTS_FILE, self.counts), (SIGHTINGS_FILE, self.sightings), (TOUCHES_FILE, self.touches),
        )  # fmt: skip
        for name, every in rows:
            end = len(every)  # the loop may append meanwhile
            new = every[self._written[name] : end]
            if not new:
                continue
            file = AppendFile(self.folder / name)
            try:
                file.append("".join(json.dumps(row, allow_nan=False) + "\n" for row in new).encode())
                file.sync()
            finally:
                file.close()
            self._written[name] = end

    def write_data_set(self, header: Mapping[str, Any]) -> Path:
        """``belt.json``, which the solver, replay and report read."""
        self.flush()
        data = {
            "schema": SCHEMA,
            **header,
            "encoder": [[t, count] for t, count, _ in self.counts],
            "begins": self.begins,
            "sightings": self.sightings,
            "touches": self.touches,
        }
        path = self.folder / DATA_FILE
        write_atomic(path, to_json(data) + "\n")
        return path


def read_data_set(path: Path) -> dict[str, Any]:
    """A data set (its file, or the folder that has it); ``DATA_INVALID`` when it is none."""
    file = path / DATA_FILE if path.is_dir() else path
    data = read_json(file)
    if not isinstance(data, dict) or data.get("schema") != SCHEMA:
        raise error("DATA_INVALID", f"{file} is no {SCHEMA}")
    return data
