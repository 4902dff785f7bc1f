"""The SHA-256 of every file of a run, as ``sha256sum`` prints it, and one digest of them all.

``sha256sum -c`` checks such a list without this program. What is drawn or added after the run has ended, a
report and signatures for instance, is no part of the record and changes no digest.
"""

import hashlib
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from cell.errors import error
from cell.store.files import disk_errors

SUMS_FILE, BUNDLE_FILE, SIGNATURES_FILE = "SHA256SUMS", "bundle.json", "signatures.jsonl"
ADDED_LATER = frozenset(
    {"report.html", "report.pdf", "figures.csv", "truth.json", SIGNATURES_FILE, SUMS_FILE, BUNDLE_FILE}
)  # of the top folder
_LINE = re.compile(r"(?P<sum>[0-9a-f]{64})  (?P<path>[^\n]+)")


@dataclass(frozen=True)
class Fingerprint:
    """``sums`` has the SHA-256 (hexadecimal) of each file by its path in the run folder."""

    sums: Mapping[str, str]

    @property
    def text(self) -> str:
        """As ``sha256sum`` prints it, by path."""
        return "".join(f"{self.sums[path]}  {path}\n" for path in sorted(self.sums))

    @property
    def record(self) -> "Fingerprint":
        """Of the files of the record alone."""
        return Fingerprint({path: sum_ for path, sum_ in self.sums.items() if path not in ADDED_LATER})

    @property
    def digest(self) -> str:
        """SHA-256 (hexadecimal) of the list of the record's files."""
        return hashlib.sha256(self.record.text.encode()).hexdigest()

    def against(self, before: "Fingerprint") -> list[str]:
        """What became of the files that ``before`` lists, in words: one line for each that differs."""
        lines = []
        for path in sorted({*self.sums, *before.sums}):
            if path not in self.sums:
                lines.append(f"{path} is missing")
            elif path not in before.sums:
                lines.append(f"{path} was added")
            elif self.sums[path] != before.sums[path]:
                lines.append(f"{path} was altered")
        return lines


def parse_sums(text: str, where: str) -> Fingerprint:
    """A list as ``sha256sum`` prints it; ``FILE_UNREADABLE`` names the line that is none."""
    sums: dict[str, str] = {}
    for number, line in enumerate(text.splitlines(), 1):
        if (match := _LINE.fullmatch(line)) is None:
            raise error(
                "FILE_UNREADABLE", f"{where}:{number}: a SHA-256, two spaces and a path were expected"
            )
        sums[match["path"]] = match["sum"]
    return Fingerprint(sums)


def fingerprint(folder: Path) -> Fingerprint:
    """Of every file below ``folder`` that has a name without a leading point; it reads all of them.

    ``FILE_UNREADABLE`` for a link or a device among them: what it holds is not in the folder.
    """
    return Fingerprint({path.relative_to(folder).as_posix(): _sum_of(path) for path in files_below(folder)})


def fingerprint_as_last_seen(folder: Path) -> Fingerprint:
    """As :func:`fingerprint`; files of which size and times are those of an earlier call are not read again.

    For lists that are looked at often. The time of the last change of an entry (ctime) is among them, which
    no program sets back.
    """
    with disk_errors(folder):
        seen = tuple((str(path), s.st_size, s.st_mtime_ns, s.st_ctime_ns, s.st_ino)
                     for path, s in ((path, path.stat()) for path in files_below(folder)))  # fmt: skip
    return _fingerprint_of(folder, seen)


@lru_cache(maxsize=512)
def _fingerprint_of(folder: Path, _seen: tuple[object, ...]) -> Fingerprint:
    return fingerprint(folder)


def sum_of(path: Path) -> str:
    """The SHA-256 of one file, which is not read again while its size and times are those of before."""
    with disk_errors(path):
        s = path.stat()
    return _sum_as_seen(path, (s.st_size, s.st_mtime_ns, s.st_ctime_ns, s.st_ino))


@lru_cache(maxsize=1024)
def _sum_as_seen(path: Path, _seen: tuple[object, ...]) -> str:
    return _sum_of(path)


def files_below(folder: Path) -> list[Path]:
    """Every file of a run, by path; temporary files are left out."""
    found = []
    with disk_errors(folder):
        for where, folders, names in os.walk(folder):
            folders[:] = sorted(name for name in folders if not name.startswith("."))
            for name in [*names, *(n for n in folders if (Path(where) / n).is_symlink())]:
                path = Path(where) / name
                if name.startswith("."):
                    continue
                if path.is_symlink() or not path.is_file():
                    raise error("FILE_UNREADABLE", f"{path} is a link or no file; a run holds files alone")
                found.append(path)
    return sorted(found)


def _sum_of(path: Path) -> str:
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as exc:
        raise error("FILE_UNREADABLE", f"{path}: {exc.strerror or exc}") from exc
