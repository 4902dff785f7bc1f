"""Tracker points from tables of others: CSV with a header, and MATLAB files without objects."""

import csv
import io
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cell.errors import CellError, error
from cell.formats.kincal import SCHEMA
from cell.formats.reading import MAX_BYTES

CSV_SUFFIXES, MAT_SUFFIX = (".csv", ".txt", ".tsv"), ".mat"
_JOINT = re.compile(r"^q_?(\d+)$")
_PLACES = (("x", "y", "z"), ("px", "py", "pz"), ("x_m", "y_m", "z_m"))
_TARGETS = ("target", "targets", "smr", "reflector")
_POINTS = ("p_tracker", "p", "points", "xyz")


def is_table(path: Path) -> bool:
    """Whether the file is one of these, by its name."""
    return path.suffix.lower() in (*CSV_SUFFIXES, MAT_SUFFIX)


def read_table(path: Path) -> dict[str, Any]:
    """The table as a ``cellward.kincal/1`` data set without a robot."""
    if not path.is_file():
        raise error("FILE_MISSING", f"{path} does not exist; give the path of a data set")
    if path.stat().st_size > MAX_BYTES:
        raise error("FILE_UNREADABLE", f"{path} has more than the {MAX_BYTES} bytes allowed")
    columns = _mat(path) if path.suffix.lower() == MAT_SUFFIX else _csv(path)
    return {"schema": SCHEMA, "samples": _samples(path, columns)}


def _samples(path: Path, columns: Mapping[str, Sequence[Any]]) -> list[dict[str, Any]]:
    joints = sorted((int(m.group(1)), name) for name in columns if (m := _JOINT.match(name)))
    if not joints or [k for k, _ in joints] != list(range(1, len(joints) + 1)):
        have = ", ".join(columns) or "none"
        raise error("DATA_INVALID", f"{path} needs columns q1, q2, ... without a gap; it has {have}")
    places = next((names for names in _PLACES if all(name in columns for name in names)), None)
    if places is None:
        raise error("DATA_INVALID", f"{path} needs columns x, y and z in metres; it has {', '.join(columns)}")
    target = next((name for name in _TARGETS if name in columns), None)
    out = []
    for k in range(len(columns[joints[0][1]])):
        point = [columns[name][k] for name in places]
        sample: dict[str, Any] = {
            "q": [columns[name][k] for _, name in joints],
            "p_tracker": None if any(v is None for v in point) else point,
        }
        missing = [name for (_, name), v in zip(joints, sample["q"], strict=True) if v is None]
        if missing:
            raise error("DATA_INVALID", f"{path} row {k + 1}: {missing[0]} is missing; write a number")
        if target is not None and columns[target][k] not in (None, ""):
            sample["target"] = str(columns[target][k])
        out.append(sample)
    return out


def _csv(path: Path) -> dict[str, list[Any]]:
    try:
        text = path.read_text("utf-8-sig")
    except (OSError, UnicodeDecodeError) as exc:
        raise error("FILE_UNREADABLE", f"{path} cannot be read ({exc}); replace it with a good copy") from exc
    lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    if not lines:
        raise error("DATA_INVALID", f"{path} is empty; it needs a header q1..qn,x,y,z,target and rows")
    mark = max(";,\t", key=lines[0].count)
    rows = list(csv.reader(io.StringIO("\n".join(lines)), delimiter=mark, skipinitialspace=True))
    header = [name.strip().lower() for name in rows[0]]
    if len(set(header)) != len(header):
        raise error("DATA_INVALID", f"{path} names a column twice in its header; name each once")
    columns: dict[str, list[Any]] = {name: [] for name in header}
    for number, row in enumerate(rows[1:], start=1):
        if len(row) != len(header):
            raise error(
                "DATA_INVALID",
                f"{path} row {number} has {len(row)} cells, the header {len(header)}; correct it",
            )
        for name, cell in zip(header, row, strict=True):
            columns[name].append(_cell(path, number, name, cell.strip(), mark))
    return columns


def _cell(path: Path, number: int, name: str, cell: str, mark: str) -> Any:
    if name in _TARGETS or not (_JOINT.match(name) or any(name in names for names in _PLACES)):
        return cell
    if not cell or cell.lower() in ("nan", "null", "none"):
        return None
    try:
        value = float(cell.replace(",", ".") if mark == ";" else cell)
    except ValueError:
        raise error("DATA_INVALID", f"{path} row {number}: {name} is {cell!r}; write a number") from None
    if not np.isfinite(value):
        raise error("DATA_INVALID", f"{path} row {number}: {name} is {cell!r}; write a number")
    return value


def _mat(path: Path) -> dict[str, list[Any]]:
    from scipy.io import loadmat  # slow to import, and seldom needed

    try:
        raw = loadmat(path, squeeze_me=False, struct_as_record=True)
    except NotImplementedError as exc:
        raise error("FILE_UNREADABLE", f"{path} is of MATLAB 7.3; save it with '-v7'") from exc
    except CellError:
        raise
    except Exception as exc:  # SciPy raises whatever its parser stumbles over
        raise error("FILE_UNREADABLE", f"{path} is no MATLAB file ({exc}); save it with '-v7'") from exc
    variables = {name.lower(): value for name, value in raw.items() if not name.startswith("__")}
    columns: dict[str, list[Any]] = {}
    for name, value in variables.items():
        if name in _TARGETS:
            columns[name] = _words(value)
        elif isinstance(value, np.ndarray) and np.issubdtype(value.dtype, np.number):
            columns |= _numbers(path, name, np.asarray(value))
    if not any(_JOINT.match(name) for name in columns):
        have = ", ".join(variables) or "nothing"
        raise error(
            "DATA_INVALID",
            f"{path} needs a matrix q with a column for each joint, or columns q1, q2, ...; it has {have}",
        )
    lengths = {name: len(column) for name, column in columns.items()}
    if len(set(lengths.values())) > 1:
        listed = ", ".join(f"{name} {n}" for name, n in lengths.items())
        raise error("DATA_INVALID", f"{path} has columns of different lengths: {listed}; make them equal")
    return columns


def _numbers(path: Path, name: str, value: np.ndarray) -> dict[str, list[Any]]:
    """One column, or the columns of a matrix ``q`` (n, j) or ``p_tracker`` (n, 3)."""
    wanted = bool(_JOINT.match(name)) or any(name in names for names in _PLACES)
    if value.ndim != 2 or np.iscomplexobj(value) or not (wanted or name in ("q", *_POINTS)):
        return {}
    value = value.astype(float)
    if wanted:
        if min(value.shape) != 1:
            raise error(
                "DATA_INVALID", f"{path}: {name} is {value.shape[0]} x {value.shape[1]}; make it a column"
            )
        return {name: _nulls(value.ravel())}
    if name == "q":
        return {f"q{j + 1}": _nulls(value[:, j]) for j in range(value.shape[1])}
    if value.shape[1] != 3:
        raise error("DATA_INVALID", f"{path}: {name} has {value.shape[1]} columns; it needs x, y and z")
    return {axis: _nulls(value[:, k]) for k, axis in enumerate("xyz")}


def _nulls(column: np.ndarray) -> list[Any]:
    return [float(v) if np.isfinite(v) else None for v in column]


def _words(value: Any) -> list[Any]:
    """A cell array of text, a matrix of characters, or numbers, as words."""
    out = []
    for entry in np.asarray(value).ravel():
        word = np.asarray(entry).ravel()
        text = (
            "".join(map(str, word)) if word.dtype.kind in "US" else f"{float(word[0]):g}" if word.size else ""
        )
        out.append(text.strip())
    return out
