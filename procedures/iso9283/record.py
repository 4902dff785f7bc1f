"""The raw data of the test on disk: one line an arrival, durable before the next one."""

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from cell.formats.iso9283 import SCHEMA
from cell.store.files import disk_errors, to_json, write_atomic

SAMPLES_FILE, DATA_FILE = "samples.jsonl", "iso9283.json"


class IsoRecord:
    """What one run has measured. Methods block on the disk: call them in a thread."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.samples: list[dict[str, Any]] = []

    def add(self, sample: Mapping[str, Any]) -> None:
        """One arrival; on disk when this returns."""
        path = self.folder / SAMPLES_FILE
        with disk_errors(path), path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(sample, allow_nan=False) + "\n")
            file.flush()
            os.fsync(file.fileno())
        self.samples.append(dict(sample))

    def write_data_set(self, header: Mapping[str, Any]) -> Path:
        """``iso9283.json``, which the solver and replay read."""
        data = {"schema": SCHEMA, **header, "samples": self.samples}
        path = self.folder / DATA_FILE
        write_atomic(path, to_json(data, indent=1) + "\n")
        return path
