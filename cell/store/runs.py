"""Run folders: ``<utc>_<job>_<id>`` with everything that is needed to solve the run again."""

import os
import re
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cell.errors import CellError, error
from cell.store.files import disk_errors, read_json, sync_folder, to_json, write_atomic
from cell.store.fingerprint import sum_of
from cell.store.journal import Journal, read_journal
from cell.store.json_text import JsonText
from cell.store.run_fields import END_FIELDS, RUN_FIELDS, misfit
from cell.version import software

if TYPE_CHECKING:
    from cell.clock import Clock

RUN_SCHEMA = "cellward.run/1"
END_SCHEMA = "cellward.end/1"
JOURNAL_FILE, RESULT_FILE = "journal.jsonl", "result.json"
LAST_SECONDS_FILE = "last_seconds.json"  # of a run that failed
ALTERED = "altered"  # in the place of the verdict of a result that is not as it was at the end of its run
RESULT_SUM = "result_sha256"
_NAME = re.compile(r"(?P<utc>\d{8}T\d{6}Z)_(?P<job>[a-z0-9][a-z0-9-]*)_(?P<id>\d+)")


@dataclass
class RunFolder:
    """One run on disk. ``info`` is ``run.json``: config, versions, identities, calibrations in effect."""

    path: Path
    run_id: int
    job: str
    info: dict[str, Any]
    _clock: "Clock | None" = field(default=None, repr=False)
    _wall: Callable[[], float] = field(default=time.time, repr=False)
    _journal: Journal | None = field(default=None, repr=False)

    @classmethod
    def create(
        cls,
        runs: Path,
        job: str,
        run_id: int,
        info: Mapping[str, Any],
        clock: "Clock",
        wall: Callable[[], float] = time.time,
    ) -> "RunFolder":
        """A new folder below ``runs`` with ``run.json`` and an open journal, both durable."""
        now = datetime.fromtimestamp(wall(), UTC)
        path = runs / f"{now:%Y%m%dT%H%M%SZ}_{job}_{run_id}"
        if _NAME.fullmatch(path.name) is None or not 0 < run_id < 2**32:
            raise error("INTERNAL", f"'{path.name}' is no name for a run folder")
        with disk_errors(path):
            path.mkdir(mode=0o750, parents=True)
        begun = {
            "schema": RUN_SCHEMA,
            "run_id": run_id,
            "job": job,
            "started": now.isoformat(),
            **info,
        }
        write_atomic(path / "run.json", to_json(begun, indent=1))
        journal = Journal(path / JOURNAL_FILE, clock, wall)
        journal.sync()
        with disk_errors(path):
            sync_folder(path)
            sync_folder(runs)
        return cls(path, run_id, job, begun, clock, wall, journal)

    def note(self, kind: str, **fields: Any) -> None:
        """One journal line: a single short write, allowed on an event loop."""
        self._open_journal().append(kind, **fields)

    def check_on_disk(self) -> None:
        """``RUN_FOLDER_LOST`` when the folder was removed or moved since the run began."""
        if self._journal is not None:
            self._journal.check_on_disk()

    def write_result(self, result: Mapping[str, Any] | JsonText) -> None:
        """``result.json``, whole or absent; ``result`` as a document or as its text."""
        self.check_on_disk()
        write_atomic(self.path / RESULT_FILE, to_json(result, indent=1))

    def finish(self, end: Mapping[str, Any]) -> None:
        """Write ``end.json``, the last file of a run; its absence means that the run was interrupted."""
        journal = self._open_journal()
        try:
            journal.sync()
            ended = datetime.fromtimestamp(self._wall(), UTC).isoformat()
            last = {"schema": END_SCHEMA, "ended": ended, "software": software(), **end}
            if (result := self.path / RESULT_FILE).is_file():
                try:
                    last[RESULT_SUM] = sum_of(result)
                except CellError as exc:  # the end of the run is worth more than the sum of its result
                    self.note("error", event="no sum of the result", **exc.as_dict())
            write_atomic(self.path / "end.json", to_json(last, indent=1))
        finally:
            self.close()

    def mark_interrupted(self) -> dict[str, Any]:
        """Write the end that a killed daemon could not; returns it.

        If the journal already has its terminal line, only ``end.json`` was missing and that line is the end.
        """
        terminal = (line for line in reversed(self.read_journal()) if line.get("terminal"))
        last = next((line for line in terminal if misfit(END_FIELDS, line) is None), None)
        if last is None:
            failure = error("RUN_INTERRUPTED", f"run {self.run_id} ({self.job}) has no end")
            end = {
                "outcome": "interrupted",
                "packml": "ABORTED",
                "verdict": None,
                "error": failure.as_dict(),
            }
            self.note("state", terminal=True, **end)
        else:
            end = {k: v for k, v in last.items() if k not in ("seq", "t", "kind", "terminal")}
        self.finish(end)
        return end

    def read_journal(self) -> list[dict[str, Any]]:
        """All whole lines of the journal; none when a kill came before its first."""
        path = self.path / JOURNAL_FILE
        return read_journal(path) if path.exists() else []

    def read_result(self) -> dict[str, Any] | None:
        return self._read_optional(RESULT_FILE)

    def read_end(self) -> dict[str, Any] | None:
        """``end.json``, or None without one; ``FILE_UNREADABLE`` names what it should not hold.

        With the verdict ``altered`` and no figure where ``result.json`` is not as it was at the end; without
        both where it cannot be read.
        """
        end = self._read_optional("end.json")
        if end is not None and (wrong := misfit(END_FIELDS, end)):
            raise error("FILE_UNREADABLE", f"{self.path / 'end.json'}: {wrong}")
        if end is None:
            return None
        try:
            altered = result_altered(self.path, end)
        except CellError:
            return {**end, "verdict": None, "figure": None}
        return {**end, "verdict": ALTERED, "figure": None} if altered else end

    def close(self) -> None:
        """Close the journal; done by :meth:`finish`."""
        if self._journal is not None:
            self._journal.close()
            self._journal = None

    def _open_journal(self) -> Journal:
        if self._journal is None:
            from cell.clock import MonotonicClock  # with the event loop behind it; a listing needs neither

            clock = self._clock or MonotonicClock()
            self._journal = Journal(self.path / JOURNAL_FILE, clock, self._wall)
        return self._journal

    def _read_optional(self, name: str) -> dict[str, Any] | None:
        path = self.path / name
        if not path.exists():
            return None
        content = read_json(path)
        if not isinstance(content, dict):
            raise error("FILE_UNREADABLE", f"{path}: a JSON object was expected")
        return content


def result_altered(folder: Path, end: Mapping[str, Any]) -> bool:
    """Whether ``result.json`` is not as it was at the ``end`` of the run; early ends have no sum of it."""
    kept, path = end.get(RESULT_SUM), folder / RESULT_FILE
    return kept is not None and (not path.is_file() or sum_of(path) != kept)


def altered_in(folder: Path) -> bool:
    """:func:`result_altered` of a run folder; ``FILE_UNREADABLE``. A folder without an end has no sum."""
    end = read_json(folder / "end.json") if (folder / "end.json").is_file() else {}
    return isinstance(end, Mapping) and result_altered(folder, end)


def list_runs(runs: Path, newest: int | None = None) -> list[RunFolder]:
    """The runs, oldest first; a run whose ``run.json`` cannot be read has ``info["unreadable"]``.

    Their numbers are their order, as a clock may be set back. With ``newest``, only that many: the folders'
    names carry the number, so they are the index, and only the folders that are asked for are opened.
    """
    return [_from_disk(runs / name, run_id, job) for name, run_id, job in _run_names(runs, newest)]


def interrupted_runs(runs: Path) -> list[RunFolder]:
    """The runs without an ``end.json``: their daemon was killed, or could not write."""
    return [
        _from_disk(runs / name, run_id, job)
        for name, run_id, job in _run_names(runs)
        if not os.path.exists(runs / name / "end.json")
    ]


def _run_names(runs: Path, newest: int | None = None) -> list[tuple[str, int, str]]:
    """Name, number and job of the run folders, oldest first; with ``newest``, of that many."""
    if not runs.is_dir():
        return []
    with disk_errors(runs):
        names = os.listdir(runs)
    numbered = ((int(n), name) for name in names if (n := name.rpartition("_")[2]).isdecimal())
    matches = (_NAME.fullmatch(name) for _, name in sorted(numbered, reverse=True))
    found = ((m.string, int(m["id"]), m["job"]) for m in matches if m and (runs / m.string).is_dir())
    return list(islice(found, newest))[::-1]


def load_run(runs: Path, run_id: int) -> RunFolder:
    """The run with this number; ``NOT_FOUND``, or ``FILE_UNREADABLE`` with the reason."""
    for path in sorted(runs.glob(f"*_{run_id}"), reverse=True):
        match = _NAME.fullmatch(path.name)
        if match is not None and int(match["id"]) == run_id:
            run = _from_disk(path, run_id, match["job"])
            if "unreadable" in run.info:
                raise error("FILE_UNREADABLE", run.info["unreadable"])
            return run
    raise error("NOT_FOUND", f"run {run_id} in {runs}")


def highest_run_id(runs: Path) -> int:
    """The greatest number a folder below ``runs`` carries, 0 when there is none."""
    names = (_NAME.fullmatch(path.name) for path in runs.iterdir()) if runs.is_dir() else ()
    return max((int(match["id"]) for match in names if match is not None), default=0)


def _from_disk(path: Path, run_id: int, job: str) -> RunFolder:
    try:
        info = read_json(path / "run.json")
        if not isinstance(info, dict) or info.get("schema") != RUN_SCHEMA:
            raise error("FILE_UNREADABLE", f"{path / 'run.json'}: schema '{RUN_SCHEMA}' was expected")
        if wrong := misfit(RUN_FIELDS, info):
            raise error("FILE_UNREADABLE", f"{path / 'run.json'}: {wrong}")
    except CellError as exc:
        info = {"unreadable": exc.detail}
    return RunFolder(path, run_id, job, info)
