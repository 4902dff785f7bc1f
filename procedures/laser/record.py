"""The raw data of a crossed-beam measurement on disk: one line a way, durable before the next move.

``passes.jsonl`` has every way with what became of it. ``laser.json`` is the data set of the usable ones,
written before anything is solved.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from cell.store.files import append_lines, disk_errors, to_json, write_atomic
from procedures.laser.packed import unpacked
from procedures.laser.sweep import BeamPass

PASSES_FILE = "passes.jsonl"
DATA_FILE = "laser.json"
FINISHED_EARLY = "finished_early_after_ways"  # in the notes of a data set
SECOND, THIRD = "second", "third"  # folders of the scans with the candidate tool


@dataclass
class PassRecord:
    """The ways of one scan. Methods that write block on the disk: call them in a thread."""

    folder: Path
    passes: list[dict[str, Any]] = field(default_factory=list)

    def add(self, ways: tuple[BeamPass, ...], phase: str, place: int, why_not: str | None) -> None:
        """Ways that belong together; ``why_not`` says why they are not used. On disk when this returns."""
        entries = [{**way.as_pass(), "notes": {"phase": phase, "place": place}} for way in ways]
        about = {"used": why_not is None, "why": why_not}
        with disk_errors(self.folder):
            self.folder.mkdir(exist_ok=True)
        append_lines(self.folder / PASSES_FILE, ({**about, **e} for e in entries))
        if why_not is None:
            self.passes += entries

    def write_data_set(
        self, header: Mapping[str, Any], reference: Sequence[Any], current: Sequence[Any], complete: bool
    ) -> Path:
        """``laser.json``: ``header`` has attitude, beams and tool; then the passes of both, plain.

        Without ``complete`` its notes say that the run was finished early and after how many ways, so that
        whoever solves it again comes to the verdict of the run.
        """
        data = {
            "schema": "cellward.laser/1",
            **header,
            "reference": {"passes": [unpacked(entry) for entry in reference]},
            "current": {"passes": list(current)},
        }
        if not complete:
            data["notes"] = {FINISHED_EARLY: len(self.passes)}
        path = self.folder / DATA_FILE
        with disk_errors(path):
            self.folder.mkdir(exist_ok=True)
        write_atomic(path, to_json(data) + "\n")
        return path
