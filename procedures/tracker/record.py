"""The raw data of a sampling on disk: one line a finished pose, durable before the next one.

``samples.jsonl`` also has the tracker's place and every look at a monument, which taking up again needs.
``kincal.json`` and ``heldout.json`` are the data sets made of it, written when measuring ends, whatever ended
it: what is solved and what was set aside to judge it. After a kill the lines say the same.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from cell.formats.tracker_samples import FILE_NAME, SCHEMA, as_data_set, read_lines
from cell.store.files import append_lines, to_json, write_atomic
from procedures.tracker.monuments import compare, first_seen, moved_text

DATA_FILE = "kincal.json"
HELD_OUT_FILE = "heldout.json"


@dataclass
class SampleRecord:
    """What one run has measured. Methods that write block on the disk: call them in a thread."""

    folder: Path
    header: dict[str, Any] = field(default_factory=dict)
    samples: list[dict[str, Any]] = field(default_factory=list)
    looks: list[dict[str, Any]] = field(default_factory=list)  # at the monuments, oldest first
    T_base_tracker: list[float] | None = None

    @classmethod
    def read(cls, folder: Path) -> "SampleRecord":
        """The finished poses of a run folder; a line torn by a kill is left out.

        ``FILE_UNREADABLE`` when a whole line is damaged.
        """
        record, path = cls(folder), folder / FILE_NAME
        for entry in read_lines(path) if path.exists() else ():
            record._take(entry)
        return record

    def vouched_for(self, limit_m: float) -> "SampleRecord":
        """Without looks that found a monument further off than ``limit_m``, and the poses before these.

        When the stand moved is unknown for those poses, even if it stands where it stood by now. Poses after
        the last look stay: the next look judges them.
        """
        kept = SampleRecord(self.folder, self.header, T_base_tracker=self.T_base_tracker)
        begin = 0
        for look in self.looks:
            moved = moved_text(compare(self.looks[0]["points"], look["points"]), limit_m)
            if moved is None:
                kept.samples += self.samples[begin : look["after"]]
                kept.looks.append({**look, "after": len(kept.samples)})
            begin = look["after"]
        kept.samples += self.samples[begin:]
        return kept

    def begin(self, header: Mapping[str, Any], adopted: "SampleRecord | None" = None) -> None:
        """Write the header, and take over what ``adopted`` has measured."""
        self._append({"kind": "header", "schema": SCHEMA, **header})
        if adopted is None:
            return
        if adopted.T_base_tracker is not None:
            self.place_tracker(adopted.T_base_tracker)
        for look in adopted.looks:
            self.add_look(look)
        for sample in adopted.samples:
            self.add_sample(sample)

    def place_tracker(self, T_base_tracker: list[float]) -> None:
        """Where the tracker was found (pose6)."""
        self._append({"kind": "tracker", "T_base_tracker": T_base_tracker})

    def add_look(self, look: Mapping[str, Any]) -> None:
        """One look at the monuments: ``after`` so many samples, ``points`` by name."""
        self._append({"kind": "monuments", **look})

    def add_sample(self, sample: Mapping[str, Any]) -> None:
        """One finished pose; on disk when this returns."""
        self._append({"kind": "sample", **sample})

    def left(self) -> dict[str, Any]:
        """``cellward.kincal/1`` from the lines alone, for a run that ended before its data sets were written.

        What the monuments do not vouch for is left out, as when a run is taken up.
        """
        good = self.vouched_for(self.header.get("max_drift_m", np.inf))
        notes = {
            "finished": len(self.samples),
            "doubted": len(self.samples) - len(good.samples),
            "sampling": {
                "monument_points": first_seen(good.looks),
                "serials": self.header.get("serials", {}),
            },
        }
        return {**as_data_set(self.header, good.samples, aside=False), "notes": notes}

    @property
    def unlooked(self) -> int:
        """Samples since the last look at the monuments."""
        return len(self.samples) - int(self.looks[-1]["after"] if self.looks else 0)

    def write_data_sets(self, notes: Mapping[str, Any], stored: Sequence[Mapping[str, Any]] = ()) -> Path:
        """``kincal.json``, with what is ``stored`` of another set, and ``heldout.json``; the first's path."""
        for name, aside in ((HELD_OUT_FILE, True), (DATA_FILE, False)):
            data = {**as_data_set(self.header, self.samples, aside=aside), "notes": dict(notes)}
            if not aside:
                data["samples"] += [{**s, "index": len(self.samples) + k} for k, s in enumerate(stored)]
            write_atomic(self.folder / name, to_json(data, indent=1) + "\n")
        return self.folder / DATA_FILE

    def _append(self, entry: Mapping[str, Any]) -> None:
        append_lines(self.folder / FILE_NAME, [entry])
        self._take(entry)

    def _take(self, entry: Mapping[str, Any]) -> None:
        rest = {k: v for k, v in entry.items() if k != "kind"}
        match entry["kind"]:
            case "header":
                self.header = {k: v for k, v in rest.items() if k != "schema"}
            case "tracker":
                self.T_base_tracker = rest["T_base_tracker"]
            case "monuments":
                self.looks.append({"after": rest["after"], "t": rest["t"], "points": rest["points"]})
            case "sample":
                self.samples.append(rest)
