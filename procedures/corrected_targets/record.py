"""The raw data of the job on disk: ``corrected-targets.json``, written anew after each arrival."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from cell.formats.corrected_targets import SCHEMA, CorrectedTargets
from cell.formats.reading import parse, read_json
from cell.store.files import to_json, write_atomic

DATA_FILE = "corrected-targets.json"


def read_data_set(path: Path) -> CorrectedTargets:
    """The file of a run; raises an ``InputError``."""
    return parse(CorrectedTargets, read_json(path), SCHEMA, str(path))


class TargetRecord:
    """What one run has measured. Methods block on the disk: call them in a thread."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / DATA_FILE
        self.arrivals: list[dict[str, Any]] = []
        self._header: dict[str, Any] = {}

    def begin(self, header: Mapping[str, Any]) -> None:
        """Write what was planned."""
        self._header = dict(header)
        self._write()

    def add(self, arrival: Mapping[str, Any]) -> None:
        """One arrival; on disk when this returns."""
        self.arrivals.append(dict(arrival))
        self._write()

    def _write(self) -> None:
        data = {"schema": SCHEMA, **self._header, "arrivals": self.arrivals}
        write_atomic(self.path, to_json(data, indent=1) + "\n")
