"""Everything that a report is drawn from: a result, and what the run folder has beside it."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from calibration.hand_eye.observability import axes_frame
from cell.errors import CellError
from cell.poses import Array
from cell.store.files import read_json
from procedures.report.measured import Measured, measure
from procedures.report.numbers import dig, matrix4
from procedures.solve.capture import FILE_NAME

JOURNAL_FILE = "journal.jsonl"
_NAME_OF = {"eye-in-hand": "T_flange_camera", "eye-to-hand": "T_base_camera"}
_TARGET_OF = {"eye-in-hand": "T_base_target", "eye-to-hand": "T_flange_target"}


@dataclass
class Source:
    """One result with its surroundings; what is not there is empty, and ``missing`` says why."""

    result: Mapping[str, Any]
    data: Path | None = None
    run: Mapping[str, Any] = field(default_factory=dict)
    end: Mapping[str, Any] = field(default_factory=dict)
    journal: list[dict[str, Any]] = field(default_factory=list)
    missing: list[str] = field(default_factory=list)

    @property
    def answer(self) -> Mapping[str, Any] | None:
        """``result.result``: None when the data could not determine it."""
        found = self.result.get("result")
        return found if isinstance(found, Mapping) else None

    @property
    def setup(self) -> str:
        stated = dig(self.result, "inputs", "setup")
        if stated in _NAME_OF:
            return str(stated)
        return "eye-to-hand" if dig(self.answer, "T_base_camera") is not None else "eye-in-hand"

    @property
    def name(self) -> str:
        """The field of X: ``T_flange_camera`` or ``T_base_camera``."""
        return _NAME_OF[self.setup]

    @property
    def parent(self) -> str:
        """The frame that the camera is given in."""
        return axes_frame("eye-in-hand" if self.setup == "eye-in-hand" else "eye-to-hand")

    @property
    def target_parent(self) -> str:
        """The frame that the target rests in."""
        return "base" if self.setup == "eye-in-hand" else "flange"

    @property
    def X(self) -> Array | None:
        """The answer (4, 4)."""
        return matrix4(dig(self.answer, self.name))

    @property
    def targets(self) -> dict[int, Array]:
        """The pose (4, 4) of the target in each placement."""
        found = dig(self.answer, _TARGET_OF[self.setup])
        poses = found.items() if isinstance(found, Mapping) else ()
        matrices = ((int(group), matrix4(pose)) for group, pose in poses if str(group).lstrip("-").isdigit())
        return {group: T for group, T in matrices if T is not None}

    @property
    def before(self) -> tuple[str, Array] | None:
        """Where the pose in effect before this run came from, and that pose (4, 4)."""
        values = self.run.get("values")
        T = matrix4(dig(values, "calibration", self.setup, "X"))
        version = dig(values, "versions", self.name)
        if T is not None:
            return ("the configured pose" if version is None else f"version {version}"), T
        T = matrix4(dig(values, "configured", self.name))
        return None if T is None else ("the configured pose", T)

    @cached_property
    def measured(self) -> Measured | None:
        """What the capture shows; None, with a line in ``missing``, when it cannot be read."""
        if self.data is None:
            self.missing.append("No data set is at hand, so the poses cannot be drawn.")
            return None
        try:
            return measure(self.data, self.result)
        except CellError as exc:
            self.missing.append(f"The data set cannot be read: {exc}")
            return None


def from_folder(folder: Path) -> Source:
    """A run folder. ``result.json`` is needed; everything else may be missing and is said to be."""
    result = read_json(folder / "result.json")
    source = Source(result if isinstance(result, Mapping) else {})
    data = folder / FILE_NAME
    source.data = data if data.exists() else None
    source.run = _optional(folder / "run.json", source.missing)
    if (folder / "end.json").exists():
        source.end = _optional(folder / "end.json", source.missing)
    source.journal = _journal(folder / JOURNAL_FILE, source.missing)
    return source


def from_result(result: Mapping[str, Any], data: Path | None) -> Source:
    """A result alone; its data set is ``data``, or what ``inputs.path`` names."""
    named = dig(result, "inputs", "path")
    if data is None and isinstance(named, str):
        data = Path(named)
    return Source(result, data)


def _optional(path: Path, missing: list[str]) -> Mapping[str, Any]:
    try:
        found = read_json(path)
    except CellError as exc:
        missing.append(str(exc))
        return {}
    return found if isinstance(found, Mapping) else {}


def _journal(path: Path, missing: list[str]) -> list[dict[str, Any]]:
    """The whole lines of a journal that may still be growing."""
    try:
        lines = path.read_text("utf-8", errors="replace").splitlines()
    except OSError as exc:
        missing.append(f"The journal cannot be read: {exc.strerror}")
        return []
    found = []
    for line in lines:
        try:
            entry = json.loads(line)
        except ValueError:
            continue  # the line that was being written, or one that a kill tore
        if isinstance(entry, dict) and "kind" in entry:
            found.append(entry)
    return found
