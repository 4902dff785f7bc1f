"""Which run folders and which pictures may be removed, and their removal.

A run folder is kept while it may be needed: it has no end yet, it is the newest, or a calibration that is
proposed, accepted, in effect or can be returned to came from it. Of a complete capture, the pictures whose
corners are in ``capture.json`` are kept; those of failed attempts and depth pictures are in no solution.
"""

import json
import os
import shutil
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from cell.errors import CellError, error
from cell.store.files import append_lines, contents, disk_errors, read_json, sync_folder
from cell.store.fingerprint import SIGNATURES_FILE
from cell.store.runs import RunFolder, list_runs

RECORD_FILE = "pruned.jsonl"
_LEAVING = ".pruned-"  # no name of a run folder: a removal that was interrupted leaves no half run
CAPTURE_FILE, IMAGES = "capture.json", "images"
_RECORDED = {
    "at": int | float, "who": str, "run_id": int, "job": str, "bytes": int, "why": str, "pictures": int
}  # fmt: skip


@dataclass(frozen=True)
class Keep:
    """How much is kept; None does not bound. A run beyond any of the bounds may go, the oldest first."""

    runs: int | None = None
    age_days: float | None = None
    size_gb: float | None = None  # 10^9 bytes, of all run folders together


@dataclass(frozen=True)
class Removal:
    """What goes of one run: its folder, or only ``files`` in it; ``bytes`` that no other folder shares."""

    run_id: int
    job: str
    folder: Path
    bytes: int
    why: str
    files: tuple[Path, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        return {
            "run_id": self.run_id,
            "job": self.job,
            "folder": self.folder.name,
            "bytes": self.bytes,
            "why": self.why,
            "pictures": len(self.files),
        }


def plan(runs: Path, keep: Keep, needed: Mapping[int, str], now: float | None = None) -> list[Removal]:
    """The run folders beyond ``keep``, oldest first. ``needed`` are the runs that calibrations rest on.

    ``now`` is in seconds since 1970. A run that is needed counts towards the bounds and is never in the list.
    """
    found = list_runs(runs)
    now = time.time() if now is None else now
    newest = found[-1].run_id if found else None
    sizes = {run.run_id: size_of(files_of(run.path)) for run in found}
    total = sum(sizes.values())
    removals = []
    for place, run in enumerate(found):
        why = _beyond(keep, len(found) - place, _age_days(run, now), total)
        if why is None or run.run_id in needed or run.run_id == newest or not _ended(run):
            continue
        total -= sizes[run.run_id]
        removals.append(Removal(run.run_id, run.job, run.path, sizes[run.run_id], why))
    return removals


def plan_pictures(runs: Path, without: Iterable[int] = ()) -> list[Removal]:
    """Of each complete capture, the pictures that no corner of its ``capture.json`` came from."""
    left_out = set(without)
    removals = []
    for run in list_runs(runs):
        if run.run_id not in left_out and (files := unused_pictures(run)):
            why = "pictures of failed attempts, and depth"
            removals.append(Removal(run.run_id, run.job, run.path, size_of(files), why, tuple(files)))
    return removals


def unused_pictures(run: RunFolder) -> list[Path]:
    """The pictures of a capture that ended complete which its solution has no use for; else none.

    A capture that can still be adopted keeps all, for the run that adopts it takes them over; one that was
    signed keeps what was signed.
    """
    images = run.path / IMAGES
    if not images.is_dir() or not _ended(run, "complete") or (run.path / SIGNATURES_FILE).exists():
        return []
    try:
        used = _used(read_json(run.path / CAPTURE_FILE))
    except (CellError, AttributeError, TypeError):
        return []  # not what a capture writes: nothing of it is touched
    return sorted(
        path
        for path in images.iterdir()
        if path.is_file() and not path.is_symlink() and f"{IMAGES}/{path.name}" not in used
    )


def carry_out(
    runs: Path, removals: Sequence[Removal], who: str, wall: Callable[[], float] = time.time
) -> None:
    """Remove them, each noted in ``pruned.jsonl`` beside the run folders before it goes; ``DISK_FAILED``."""
    with disk_errors(runs):
        for rest in runs.glob(f"{_LEAVING}*"):  # of a removal that was interrupted
            shutil.rmtree(rest)
    for removal in removals:
        append_lines(runs / RECORD_FILE, [{"at": wall(), "who": who, **removal.as_dict()}])
        with disk_errors(removal.folder):
            if removal.files:
                for path in removal.files:
                    path.unlink(missing_ok=True)
                continue
            leaving = runs / f"{_LEAVING}{removal.folder.name}"
            removal.folder.rename(leaving)
            sync_folder(runs)
            shutil.rmtree(leaving)


def removals_recorded(runs: Path) -> list[dict[str, Any]]:
    """What ``pruned.jsonl`` records, oldest first: ``at`` (seconds since 1970), ``who``, ``run_id``, ``job``,
    ``bytes``, ``why``, ``pictures`` (0: the folder). Lines that are not whole are left out.
    """
    path = runs / RECORD_FILE
    try:
        lines = contents(path).decode("utf-8", "replace").splitlines()
    except FileNotFoundError:
        return []
    except OSError as exc:
        raise error("FILE_UNREADABLE", f"{path}: {exc.strerror or exc}") from exc
    found = []
    for line in lines:
        try:
            entry = json.loads(line)
        except (ValueError, RecursionError):
            continue
        if isinstance(entry, dict) and all(isinstance(entry.get(k), kind) for k, kind in _RECORDED.items()):
            found.append(entry)
    return found


def files_of(folder: Path) -> list[Path]:
    """Every file below ``folder``; none where it cannot be read."""
    return [Path(root) / name for root, _, names in os.walk(folder) for name in names]


def size_of(files: Iterable[Path]) -> int:
    """Bytes that their removal frees: a picture that an adopted run shares frees none."""
    total = 0
    for path in files:
        try:
            status = path.lstat()
        except OSError:
            continue
        total += status.st_size if status.st_nlink == 1 else 0
    return total


def _beyond(keep: Keep, rank: int, age_days: float, total: int) -> str | None:
    if keep.runs is not None and rank > keep.runs:
        return f"older than the newest {keep.runs} runs"
    if keep.age_days is not None and age_days > keep.age_days:
        return f"older than {keep.age_days:g} days"
    if keep.size_gb is not None and total > keep.size_gb * 1e9:
        return f"the runs together are above {keep.size_gb:g} GB"
    return None


def _age_days(run: RunFolder, now: float) -> float:
    began = datetime.strptime(run.path.name[:16], "%Y%m%dT%H%M%SZ").replace(tzinfo=UTC)
    return (now - began.timestamp()) / 86400


def _ended(run: RunFolder, outcome: str | None = None) -> bool:
    """Whether the run has its end, for ``outcome`` this one. An end that cannot be read is none."""
    try:
        end = run.read_end()
    except CellError:
        return False
    return end is not None and (outcome is None or end.get("outcome") == outcome)


def _used(capture: Any) -> set[str]:
    """The pictures that an observation of the data set names, other than depth."""
    used = set()
    for observation in capture.get("observations") or []:
        used.add(observation.get("image"))
        used |= {frame.get("image") for frame in observation.get("frames") or []}
    if not used - {None}:
        raise TypeError("a capture without pictures")
    return used - {None}
