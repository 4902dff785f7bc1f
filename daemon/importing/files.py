"""Reading text, YAML and JSON of other programs: bounded in size, every failure one sentence."""

from pathlib import Path
from typing import Any

import yaml

from cell.errors import error

MAX_BYTES = 50_000_000


def read_bytes(path: Path) -> bytes:
    """The file's content; ``FILE_MISSING`` or ``FILE_UNREADABLE``."""
    if not path.is_file():
        raise error("FILE_MISSING", f"{path} does not exist, or is no file; give the file that was saved")
    try:
        if (size := path.stat().st_size) > MAX_BYTES:
            raise error("FILE_UNREADABLE", f"{path} has {size} bytes, more than the {MAX_BYTES} allowed")
        return path.read_bytes()
    except OSError as exc:
        raise error("FILE_UNREADABLE", f"{path} cannot be read: {exc.strerror or exc}") from exc


def read_text(path: Path) -> str:
    """The file's content as UTF-8, with or without a mark before it."""
    try:
        return read_bytes(path).decode("utf-8-sig")
    except UnicodeDecodeError as exc:
        raise error("FILE_UNREADABLE", f"{path} is not text in UTF-8: save it as such") from exc


def read_yaml(path: Path) -> Any:
    """The document in a YAML file; nothing in it is run. OpenCV's first line ``%YAML:1.0`` is passed over."""
    text = read_text(path).removeprefix("%YAML:1.0\n")
    if "&" in text or "!!" in text:  # anchors grow without bound, and tags are for other readers
        raise error("FILE_UNREADABLE", f"{path} has anchors or tags, which no file of this kind has")
    try:
        return yaml.safe_load(text)
    except (yaml.YAMLError, RecursionError) as exc:
        mark = getattr(exc, "problem_mark", None)
        place = f" in line {mark.line + 1}" if mark is not None else ""
        raise error("FILE_UNREADABLE", f"{path} is not YAML{place}; give the file that was saved") from exc


def numbers(value: Any, count: int) -> list[float] | None:
    """``value`` as ``count`` finite numbers, nested lists made flat; None when it is something else."""
    flat = (
        [v for row in value for v in (row if isinstance(row, list) else [row])]
        if isinstance(value, list)
        else []
    )
    good = all(isinstance(v, int | float) and not isinstance(v, bool) and abs(v) < 1e300 for v in flat)
    return [float(v) for v in flat] if good and len(flat) == count else None
