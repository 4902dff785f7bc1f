"""The raw data of the test on disk: one line an arrival, durable before the next one.

``iso9283.json`` is there from the first move on, without arrivals; whatever ends the run, they are put in.
Only a kill leaves them in ``samples.jsonl`` alone, and reading takes them from there.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from cell.errors import error
from cell.formats.iso9283 import SCHEMA, Iso9283
from cell.formats.reading import parse, read_json
from cell.store.files import append_lines, to_json, write_atomic

SAMPLES_FILE, DATA_FILE = "samples.jsonl", "iso9283.json"


def read_data_set(path: Path) -> Iso9283:
    """``iso9283.json`` with all arrivals of its run; raises an ``InputError``."""
    raw, lines = read_json(path), path.with_name(SAMPLES_FILE)
    if raw.get("samples") == [] and lines.exists():
        raw["samples"] = _finished(lines)
    return parse(Iso9283, raw, SCHEMA, str(path))


def _finished(path: Path) -> list[Any]:
    """The lines; one that a kill tore is left out, ``FILE_UNREADABLE`` when a whole one is damaged."""
    found = []
    for number, line in enumerate(path.read_bytes().splitlines(keepends=True), 1):
        if not line.endswith(b"\n"):
            break
        try:
            found.append(json.loads(line))
        except ValueError as exc:
            raise error("FILE_UNREADABLE", f"{path}:{number}: no line of a test's arrivals") from exc
    return found


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
