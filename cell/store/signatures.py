"""Who signed the record of a run: a line each in ``signatures.jsonl``, with the sums of the files signed."""

import json
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from cell.errors import CellError, error
from cell.store.files import append_lines, contents
from cell.store.fingerprint import (
    SIGNATURES_FILE,
    Fingerprint,
    fingerprint,
    fingerprint_as_last_seen,
)
from cell.store.runs import RunFolder

SCHEMA = "cellward.signature/1"
LONGEST, LONGEST_REMARK = 80, 500  # characters


@dataclass(frozen=True)
class Statement:
    """What somebody says by signing; ``digest`` is that of the files that they have looked at.

    ``ARGUMENT_INVALID`` for an empty or overlong name or role.
    """

    name: str
    role: str
    remark: str
    digest: str

    def __post_init__(self) -> None:
        for what, text, most in (
            ("name", self.name, LONGEST),
            ("role", self.role, LONGEST),
            ("remark", self.remark, LONGEST_REMARK),
        ):
            if len(text) > most or "\n" in text or (what != "remark" and not text.strip()):
                raise error(
                    "ARGUMENT_INVALID", f"the {what} of a signature is one line of 1 to {most} characters"
                )


@dataclass(frozen=True)
class Signature:
    """``name`` signed as ``role``; ``user`` is the account that it was done with. ``at`` is an ISO stamp."""

    at: str
    name: str
    role: str
    remark: str
    user: str
    digest: str
    sums: dict[str, str]

    @property
    def signed(self) -> Fingerprint:
        """The files as they were signed."""
        return Fingerprint(self.sums)


def sign(run: RunFolder, said: Statement, user: str, wall: Callable[[], float] = time.time) -> Signature:
    """Add a signature, given with the account ``user``.

    ``NOT_NOW`` for a run that has not ended, ``RECORD_ALTERED`` when its files are not those meant any more.
    """
    if run.read_end() is None:
        raise error("NOT_NOW", f"run {run.run_id} ({run.job}) has not ended; it can be signed after its end")
    found = fingerprint(run.path).record
    if found.digest != said.digest:
        raise error(
            "RECORD_ALTERED", f"run {run.run_id}: its digest is {found.digest}, and {said.digest} was meant"
        )
    at = datetime.fromtimestamp(wall(), UTC).isoformat(timespec="seconds")
    made = Signature(at=at, user=user, sums=dict(found.sums), **asdict(said))
    append_lines(run.path / SIGNATURES_FILE, [{"schema": SCHEMA, **asdict(made)}])
    return made


def read_signatures(folder: Path) -> list[Signature]:
    """The signatures of a run, oldest first; ``FILE_UNREADABLE`` names a line that is none."""
    path = folder / SIGNATURES_FILE
    if not path.exists():
        return []
    try:
        lines = contents(path).decode("utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as exc:
        raise error("FILE_UNREADABLE", f"{path}: {exc}") from exc
    return [_parsed(line, f"{path}:{number}") for number, line in enumerate(lines, 1)]


@dataclass(frozen=True)
class Checked:
    """A signature, and what is not as it was signed, in words: a line for each; none when nothing changed.

    Of a file of signatures that cannot be read, ``signature`` is None.
    """

    signature: Signature | None
    changed: tuple[str, ...] = ()


def check_signatures(folder: Path, found: Fingerprint | None = None) -> list[Checked]:
    """The signatures of a run held against its files; ``found`` is their fingerprint where it is known.

    Files are read for it only where there is a signature. Whatever cannot be read counts as changed.
    """
    try:
        signatures = read_signatures(folder)
    except CellError as exc:
        return [Checked(None, (str(exc),))]
    if not signatures:
        return []
    try:
        found = found or fingerprint_as_last_seen(folder)
    except CellError as exc:
        return [Checked(signature, (str(exc),)) for signature in signatures]
    return [Checked(signature, tuple(_changed(signature, found))) for signature in signatures]


def _changed(signature: Signature, found: Fingerprint) -> list[str]:
    if wrong := fault_of(signature, found):
        return found.record.against(signature.signed) or [wrong]
    return []


def fault_of(signature: Signature, found: Fingerprint) -> str:
    """What is wrong with a signature of the files ``found``, in words; empty when nothing is."""
    if signature.signed.digest != signature.digest:
        return "its own list of files was altered"
    return "" if signature.digest == found.digest else "it is for other files"


def _parsed(line: str, where: str) -> Signature:
    try:
        entry: dict[str, Any] = json.loads(line)
        if entry.pop("schema") != SCHEMA:
            raise ValueError(f"schema '{SCHEMA}' was expected")
        made = Signature(**entry)
    except (ValueError, TypeError, KeyError, AttributeError) as exc:
        raise error("FILE_UNREADABLE", f"{where}: no signature: {exc}") from exc
    texts = (made.at, made.name, made.role, made.remark, made.user, made.digest)
    if not all(isinstance(text, str) for text in texts) or not isinstance(made.sums, dict):
        raise error("FILE_UNREADABLE", f"{where}: no signature: a field has another type")
    return made
