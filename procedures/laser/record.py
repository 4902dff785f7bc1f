"""The raw data of a crossed-beam measurement on disk: one line a way, durable before the next move.

``passes.jsonl`` has every way with what became of it. ``laser.json`` is the data set of the usable ones,
written before anything is solved.
"""

import asyncio
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from cell.procedure import Worker
from cell.store.files import append_lines, disk_errors, to_json, write_atomic
from procedures.in_worker import in_worker
from procedures.laser.packed import unpacked
from procedures.laser.sweep import BeamPass

PASSES_FILE = "passes.jsonl"
DATA_FILE = "laser.json"
FINISHED_EARLY = "finished_early_after_ways"  # in the notes of a data set
SECOND, THIRD = "second", "third"  # folders of the scans with the candidate tool


@dataclass
class PassRecord:
    """The ways of one scan. :meth:`add` blocks on the disk: call it in a thread."""

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

    async def write_data_set(
        self, worker: Worker, header: Mapping[str, Any], reference: Sequence[Any] | None, complete: bool
    ) -> Path:
        """``laser.json``: ``header`` has attitude, beams and tool; then the passes, plain.

        They are those of ``reference`` and of this scan; without a ``reference`` this scan is one.

        Without ``complete`` its notes say that the run was finished early and after how many ways, so that
        whoever solves it again comes to the verdict of the run. ``worker`` makes the text, from the passes on
        the disk: to hand them over would hold up the loop.
        """
        notes = {} if complete else {"notes": {FINISHED_EARLY: len(self.passes)}}
        text = await in_worker(worker, _text, self.folder / PASSES_FILE, header, reference, notes)
        return await asyncio.to_thread(self._write, text)

    def _write(self, text: str) -> Path:
        path = self.folder / DATA_FILE
        with disk_errors(path):
            self.folder.mkdir(exist_ok=True)
        write_atomic(path, text)
        return path


def _text(
    file: Path, header: Mapping[str, Any], reference: Sequence[Any] | None, notes: Mapping[str, Any]
) -> str:
    scan = list(_used(file))
    then, now = (scan, []) if reference is None else ([unpacked(entry) for entry in reference], scan)
    data = {
        "schema": "cellward.laser/1",
        **header,
        "reference": {"passes": then},
        "current": {"passes": now},
        **notes,
    }
    return to_json(data) + "\n"


def _used(file: Path) -> Iterator[dict[str, Any]]:
    """The usable ways of a scan as :meth:`PassRecord.add` wrote them; none where no way was taken."""
    if not file.exists():
        return
    with disk_errors(file), file.open(encoding="utf-8") as lines:
        for line in lines:
            entry = json.loads(line)
            if entry.pop("used"):
                del entry["why"]
                yield entry
