"""Everything that a report is drawn from: a result, and what the run folder has beside it."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from html import unescape
from pathlib import Path
from typing import Any, Generic, TypeVar, cast

from cell.errors import CellError
from cell.formats.result import Envelope, Result
from cell.store.files import read_json
from cell.store.runs import altered_in
from cell.store.signatures import Checked, check_signatures

JOURNAL_FILE = "journal.jsonl"
RESULT_FILE = "result.json"
END_FILE = "end.json"
TRUTH_FILE = "truth.json"  # of a twin, written by the demo
ALTERED_TEXT = "The result was altered after the run's end: it is not what the job found."
E = TypeVar("E", bound=Envelope)
S = TypeVar("S", bound="Source[Any]")


@dataclass
class Source(Generic[E]):
    """One result of kind ``E`` with its surroundings; what is not there is empty, and ``missing`` says why.

    A kind of result whose sections want more than this has a class of its own (``HandEyeSource``).
    """

    result: Envelope
    data: Path | None = None
    run: Mapping[str, Any] = field(default_factory=dict)
    end: Mapping[str, Any] = field(default_factory=dict)
    journal: list[dict[str, Any]] = field(default_factory=list)
    missing: list[str] = field(default_factory=list)
    folder: Path | None = None
    truth: Mapping[str, Any] = field(default_factory=dict)
    decided: Sequence[Mapping[str, Any]] = ()  # rows of the ledger about results of the run
    signatures: Sequence[Checked] = ()  # without one that cannot be read
    altered: bool = False  # the result is not what the job found
    misfit: str = ""  # why the result does not fit the model of its kind

    @property
    def found(self) -> E | None:
        """The result as the model of its kind; None when the data could not determine an answer."""
        return None if isinstance(self.result, Result) else cast(E, self.result)

    def known(self, key: str) -> Any:
        """What ``observability`` says under ``key`` of data that determine no answer; None of others."""
        return self.result.observability.get(key) if isinstance(self.result, Result) else None


def read_document(folder: Path) -> Mapping[str, Any]:
    """``result.json`` of a run folder; the one file that a report cannot do without."""
    result = read_json(folder / RESULT_FILE)
    return result if isinstance(result, Mapping) else {}


def of_folder(cls: type[S], result: Envelope, folder: Path, data_file: str) -> S:
    """A run folder with its result; everything else may be missing and is said to be."""
    source = cls(result, folder=folder)
    data = folder / data_file
    source.data = data if data.exists() else None
    source.run = _optional(folder / "run.json", source.missing)
    if (folder / END_FILE).exists():
        source.end = _optional(folder / END_FILE, source.missing)
        source.altered = _altered(folder, source)
    if (folder / TRUTH_FILE).exists():
        source.truth = _optional(folder / TRUTH_FILE, source.missing)
    source.journal = _journal(folder / JOURNAL_FILE, source.missing)
    checked = check_signatures(folder)
    source.signatures = [each for each in checked if each.signature is not None]
    source.missing += [line for each in checked if each.signature is None for line in each.changed]
    return source


def _altered(folder: Path, source: Source[Any]) -> bool:
    try:
        altered = altered_in(folder)
    except CellError as exc:
        source.missing.append(str(exc))
        return False
    if altered:
        source.missing.append(ALTERED_TEXT)
    return altered


def hides_altered(folder: Path, report: str) -> bool:
    """Whether a report that was drawn of a run tells other than it is whether its result was altered: a
    time-stamp does not show that, as whoever alters or restores a file can keep it."""
    try:
        altered = altered_in(folder)
    except CellError:
        return False
    return altered != (ALTERED_TEXT in unescape(report))


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
