"""One file with everything of a run: its folder as a ZIP archive, with a list for ``sha256sum -c``."""

import hashlib
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path, PurePosixPath
from typing import IO, Any

from cell.errors import error
from cell.store.files import disk_errors, sync_folder, to_json
from cell.store.fingerprint import BUNDLE_FILE, SUMS_FILE, Fingerprint, files_below, fingerprint, parse_sums

SCHEMA = "cellward.bundle/1"
LARGEST = 64 * 2**30  # bytes that a bundle may unpack to
_PACKED = {".png", ".jpg", ".pdf"}  # packing these again gains nothing
DAMAGED = " is damaged"
_CHUNK = 1 << 20


def write_bundle(folder: Path, target: Path, about: Mapping[str, Any]) -> Fingerprint:
    """Pack the run folder into ``target``, whole or not at all; returns the sums of the files in it.

    ``about`` goes into ``bundle.json``, with the digest of the record. ``DISK_FULL``, ``DISK_FAILED``.
    """
    found = fingerprint(folder)
    described = to_json({"schema": SCHEMA, **about, "digest": found.digest}, indent=1).encode()
    sums = Fingerprint({**found.sums, BUNDLE_FILE: hashlib.sha256(described).hexdigest()})
    temporary = target.with_name(f".{target.name}.tmp")
    with disk_errors(target):
        try:
            with zipfile.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED) as archive:
                for path in files_below(folder):
                    name = path.relative_to(folder).as_posix()
                    if name not in (BUNDLE_FILE, SUMS_FILE):
                        packing = zipfile.ZIP_STORED if path.suffix in _PACKED else zipfile.ZIP_DEFLATED
                        archive.write(path, f"{folder.name}/{name}", packing)
                archive.writestr(f"{folder.name}/{BUNDLE_FILE}", described)
                archive.writestr(f"{folder.name}/{SUMS_FILE}", sums.text)
            temporary.replace(target)
        finally:
            temporary.unlink(missing_ok=True)
        sync_folder(target.absolute().parent)
    return sums


def unpack_bundle(bundle: Path, into: Path) -> tuple[Path, Fingerprint, list[str]]:
    """Unpack into a folder; where the run folder is, the sums it should have, and what could not be read.

    A file whose packed form is damaged is among the last. ``ARGUMENT_INVALID`` for a folder;
    ``FILE_UNREADABLE`` for what is no bundle, or would write elsewhere or without bound.
    """
    damaged = []
    if bundle.is_dir():
        raise error("ARGUMENT_INVALID", f"{bundle} is a folder; give the number of the run, or its bundle")
    try:
        with zipfile.ZipFile(bundle) as archive:
            entries = [entry for entry in archive.infolist() if not entry.is_dir()]
            name = _folder_of(entries, bundle)
            if sum(entry.file_size for entry in entries) > LARGEST:
                raise error("FILE_UNREADABLE", f"{bundle}: it would unpack to more than {LARGEST} bytes")
            for entry in entries:
                target = into / entry.filename
                target.parent.mkdir(parents=True, exist_ok=True)
                try:
                    with archive.open(entry) as packed, target.open("wb") as file:
                        _copy(packed, file, entry.file_size)
                except (zipfile.BadZipFile, zlib.error, EOFError, ValueError, NotImplementedError):
                    damaged.append(f"{PurePosixPath(*PurePosixPath(entry.filename).parts[1:])}{DAMAGED}")
    except FileNotFoundError:
        raise error("FILE_MISSING", f"{bundle} does not exist") from None
    except (zipfile.BadZipFile, OSError) as exc:
        raise error("FILE_UNREADABLE", f"{bundle}: no bundle of a run: {exc}") from exc
    folder = into / name
    listed = folder / SUMS_FILE
    if not listed.exists():
        raise error("FILE_UNREADABLE", f"{bundle}: no bundle of a run: it has no {SUMS_FILE}")
    return folder, parse_sums(listed.read_text("utf-8", "replace"), f"{bundle}: {SUMS_FILE}"), damaged


def _folder_of(entries: list[zipfile.ZipInfo], bundle: Path) -> str:
    """The one folder that everything is in; no entry may lead out of it."""
    parts = [PurePosixPath(entry.filename).parts for entry in entries]
    tops = {part[0] for part in parts if part}
    odd = any(len(part) < 2 or ".." in part or part[0] == "/" for part in parts)
    if odd or len(tops) != 1 or any("\\" in entry.filename for entry in entries):
        raise error("FILE_UNREADABLE", f"{bundle}: no bundle of a run: its files are not in one folder")
    return tops.pop()


def _copy(packed: IO[bytes], file: IO[bytes], size: int) -> None:
    """At most the ``size`` that the archive says, whatever is packed."""
    while size > 0 and (chunk := packed.read(min(size, _CHUNK))):
        size -= len(chunk)
        file.write(chunk)
    if size > 0 or packed.read(1):
        raise ValueError("another size than the archive says")
