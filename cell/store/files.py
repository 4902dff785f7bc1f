"""Files that are whole or absent: atomic replacement, checked reading, and setting corrupt ones aside."""

import errno
import json
import math
import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from enum import Enum
from pathlib import Path
from typing import Any

from cell.errors import error
from cell.store.json_text import JsonText, json_text

MAX_JSON_BYTES = 256 * 2**20
_AS_THEY_ARE = {int, str, bool, type(None)}  # lists of nothing else are plain
_NUMBERS = {float}  # and of these where all are finite


@contextmanager
def disk_errors(path: Path) -> Iterator[None]:
    """Turn the operating system's complaints while writing ``path`` into coded errors."""
    try:
        yield
    except OSError as exc:
        name = "DISK_FULL" if exc.errno in (errno.ENOSPC, errno.EDQUOT) else "DISK_FAILED"
        raise error(name, f"{path}: {exc.strerror or exc}") from exc


def append_lines(path: Path, entries: Iterable[Mapping[str, Any]]) -> None:
    """One JSON line for each of ``entries`` at the end of ``path``; all are on the disk when this returns.

    ``DISK_FULL`` or ``DISK_FAILED``; what then stands at the end may be half a line.
    """
    with disk_errors(path), path.open("a", encoding="utf-8") as file:
        file.writelines(json_text(entry) + "\n" for entry in entries)
        file.flush()
        os.fsync(file.fileno())


def write_atomic(path: Path, content: bytes | str) -> None:
    """Replace ``path`` by ``content``: a reader sees the old file or the new one, also after a power cut.

    Temporary name, fsync, rename, fsync of the folder. ``DISK_FULL`` or ``DISK_FAILED`` leave the old file.
    """
    data = content.encode("utf-8") if isinstance(content, str) else content
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    with disk_errors(path):
        try:
            with temporary.open("wb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            temporary.replace(path)
        except BaseException:
            with suppress(OSError):
                temporary.unlink(missing_ok=True)
            raise
        sync_folder(path.parent)


def sync_folder(folder: Path) -> None:
    """Make the names in ``folder`` durable."""
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def contents(path: Path) -> bytes:
    """What is in ``path``, or an ``OSError``. Of a pipe in its place a reader would wait for ever."""
    if path.exists() and not (path.is_file() or path.is_dir()):
        raise OSError(errno.EINVAL, "neither a file nor a folder", str(path))
    return path.read_bytes()


def read_json(path: Path, max_bytes: int = MAX_JSON_BYTES) -> Any:
    """The JSON value in ``path``; ``FILE_MISSING`` or ``FILE_UNREADABLE`` say in one sentence what is wrong.

    NaN and infinities are refused: the data formats write null instead.
    """
    try:
        size = path.stat().st_size
        if size > max_bytes:
            raise error("FILE_UNREADABLE", f"{path}: {size} bytes, more than the limit of {max_bytes}")
        return json.loads(contents(path).decode("utf-8"), parse_constant=_refuse_constant)
    except FileNotFoundError:
        raise error("FILE_MISSING", f"{path} does not exist") from None
    except OSError as exc:
        raise error("FILE_UNREADABLE", f"{path}: {exc.strerror or exc}") from exc
    except json.JSONDecodeError as exc:
        raise error("FILE_UNREADABLE", f"{path}:{exc.lineno}: not JSON: {exc.msg}") from exc
    except UnicodeDecodeError as exc:
        raise error("FILE_UNREADABLE", f"{path}: not UTF-8 text at byte {exc.start}") from exc
    except (ValueError, RecursionError) as exc:
        raise error("FILE_UNREADABLE", f"{path}: {exc}") from exc


def _refuse_constant(name: str) -> None:
    raise ValueError(f"{name} is not allowed, write null")


def to_json(value: Any, indent: int | None = None) -> str:
    """JSON of plain, numpy, path and enum values; a number that is not finite becomes null.

    :class:`JsonText` is the text of its value already, however indented.
    """
    if isinstance(value, JsonText):
        return value
    if indent is None:
        return json_text(plain(value), ensure_ascii=False)
    return json.dumps(plain(value), indent=indent, allow_nan=False, ensure_ascii=False)


def plain(value: Any) -> Any:
    """``value`` made of nothing but dict, list, str, int, float, bool and None."""
    kind = type(value)  # most values are of these kinds, and by the thousand
    if kind is float:
        return value if math.isfinite(value) else None
    if kind is int or kind is str or kind is bool or value is None:
        return value
    if kind is list:
        kinds = set(map(type, value))
        if kinds <= _AS_THEY_ARE or (kinds <= _NUMBERS and all(map(math.isfinite, value))):
            return value.copy()
        return [plain(item) for item in value]
    if isinstance(value, Enum):
        return plain(value.value)
    if isinstance(value, (int, str)):
        return value
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if callable(as_list := getattr(value, "tolist", None)):  # of numpy, which a listing need not import
        return plain(as_list())
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(item) for item in value]
    return str(value)


def free_name_aside(path: Path) -> Path:
    """Where ``path`` can be kept: ``NAME.corrupt-N`` beside it."""
    number = 1
    while (target := path.with_name(f"{path.name}.corrupt-{number}")).exists():
        number += 1
    return target


def set_aside(path: Path) -> Path:
    """Move a file that cannot be read out of the way, keeping it; returns its new name."""
    target = free_name_aside(path)
    with disk_errors(path):
        path.rename(target)
        sync_folder(path.parent)
    return target


class AppendFile:
    """A file that only grows by whole pieces: a write that fails half-way is cut off again.

    Without that, the piece written after a full disk has been cleared would follow half a piece.
    """

    def __init__(self, path: Path, keep: int | None = None) -> None:
        """Open ``path`` for appending, made if absent; with ``keep``, cut to that many bytes first."""
        self.path = path
        with disk_errors(path):
            self._handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o640)
            if keep is not None:
                os.ftruncate(self._handle, keep)
            self._end = os.lseek(self._handle, 0, os.SEEK_END)

    def append(self, data: bytes) -> None:
        """Write all of ``data`` to the operating system, or nothing; ``DISK_FULL``, ``DISK_FAILED``."""
        with disk_errors(self.path):
            try:
                rest = memoryview(data)
                while rest:
                    rest = rest[os.write(self._handle, rest) :]
            except OSError:
                os.ftruncate(self._handle, self._end)
                os.lseek(self._handle, self._end, os.SEEK_SET)
                raise
        self._end += len(data)

    def sync(self) -> None:
        """Everything appended so far is on the disk when this returns."""
        with disk_errors(self.path):
            os.fsync(self._handle)

    def in_place(self) -> bool:
        """Whether the path still names the file that is written to."""
        try:
            return os.path.samestat(self.path.stat(), os.fstat(self._handle))
        except OSError:
            return False

    def close(self) -> None:
        if self._handle >= 0:
            os.close(self._handle)
            self._handle = -1
