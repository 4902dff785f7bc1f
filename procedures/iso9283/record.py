"""The raw data of the test on disk: one line an arrival, durable before the next one."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from cell.formats.iso9283 import SCHEMA
from cell.store.files import append_lines, to_json, write_atomic

SAMPLES_FILE, DATA_FILE = "samples.jsonl", "iso9283.json"


class IsoRecord:
    """What one run has measured. Methods block on the disk: call them in a thread."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.samples: list[dict[str, Any]] = []

    def add(self, sample: Mapping[str, Any]) -> None:
        """One arrival; on disk when this returns."""
        append_lines(self.folder / SAMPLES_FILE, [sample])
        self.samples.append(dict(sample))

    def write_data_set(self, header: Mapping[str, Any]) -> Path:
        """``iso9283.json``, which the solver and replay read."""
        data = {"schema": SCHEMA, **header, "samples": self.samples}
        path = self.folder / DATA_FILE
        write_atomic(path, to_json(data, indent=1) + "\n")
        return path
