"""What is wrong with a file, as sentences with a place, and all of it at once."""

import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from difflib import get_close_matches
from typing import Any, get_args

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from cell.errors import CellError, InputError
from daemon.config.locate import Path, line_of


class ConfigInvalid(InputError):
    """``CONFIG_INVALID`` with one entry a finding, each ``file:line: path.to.key: sentence``."""

    def __init__(self, findings: Iterable[str]) -> None:
        self.findings = list(findings)
        count = len(self.findings)
        head = "" if count == 1 else f"{count} findings\n"
        super().__init__("CONFIG_INVALID", head + "\n".join(self.findings))

    def __reduce__(self) -> tuple[object, Any]:
        return ConfigInvalid, (self.findings,)


@dataclass
class Findings:
    """Collects findings about one file."""

    file: str
    lines: dict[Path, int] = field(default_factory=dict)
    _found: set[tuple[int, str]] = field(default_factory=set)
    _warned: set[tuple[int, str]] = field(default_factory=set)
    _failing: set[tuple[int, str]] = field(default_factory=set)
    _places: set[Path] = field(default_factory=set)

    def add(self, path: Path, sentence: str) -> None:
        """Something that must be corrected before the file can be used."""
        self._places.add(path)
        self._found.add(self._entry(path, sentence))

    def warn(self, path: Path, sentence: str) -> None:
        """Something that is allowed but hardly meant."""
        self._warned.add(self._entry(path, sentence))

    def add_problem(self, path: Path, sentence: str) -> None:
        """Something that one job cannot succeed with; the rest of the cell can be used."""
        self._failing.add(self._entry(path, sentence))

    def add_validation(self, base: Path, data: Any, model: type[BaseModel], exc: ValidationError) -> None:
        """The findings of a model that was given ``data``, which stands at ``base``.

        A place that has a finding already (a wrong unit is also out of bounds) gets no second one.
        """
        known = set(self._places)
        for item in exc.errors():
            place = tuple(p for p in item["loc"] if isinstance(p, str | int))
            path = _existing(data, place, keep_last=item["type"] == "missing")
            if item["type"] == "value_error":
                path = _key_meant(data, path, item["msg"])
            if base + path not in known:
                self.add(base + path, _sentence(item, model, place))

    @property
    def sentences(self) -> list[str]:
        return [self._text(entry) for entry in sorted(self._found)]

    @property
    def plain(self) -> list[str]:
        """As :attr:`sentences`, without lines: ``file: path.to.key: sentence``."""
        return [f"{self.file}: {sentence}" for _, sentence in sorted(self._found)]

    @property
    def problems(self) -> list[str]:
        return [self._text(entry) for entry in sorted(self._failing)]

    @property
    def warnings(self) -> list[str]:
        return [self._text(entry) for entry in sorted(self._warned)]

    def raise_if_any(self) -> None:
        """``CONFIG_INVALID`` with every finding so far."""
        if self._found:
            raise ConfigInvalid(self.sentences)

    def _entry(self, path: Path, sentence: str) -> tuple[int, str]:
        dotted = "".join(f"[{p}]" if isinstance(p, int) else f".{p}" for p in path).lstrip(".")
        return line_of(self.lines, path), f"{dotted}: {sentence}" if dotted else sentence

    def _text(self, entry: tuple[int, str]) -> str:
        return f"{self.file}:{entry[0]}: {entry[1]}"


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """A hint for a word that is not one of ``known``; empty when nothing is near."""
    near = get_close_matches(word, list(known), n=1, cutoff=0.6)
    return f", did you mean '{near[0]}'?" if near else ""


def with_detail(exc: CellError) -> str:
    """The sentence of a coded error without its catalogue text."""
    return exc.detail or str(exc)


def _existing(data: Any, place: Path, keep_last: bool) -> Path:
    """``place`` without the parts that pydantic added (names of union members)."""
    path: Path = ()
    for number, part in enumerate(place):
        inside = (isinstance(data, dict) and part in data) or (
            isinstance(data, list) and isinstance(part, int) and part < len(data)
        )
        if inside:
            data = data[part]
            path += (part,)
        elif keep_last and number == len(place) - 1:
            path += (part,)
    return path


def _key_meant(data: Any, path: Path, message: str) -> Path:
    """The key below ``path`` that a message about a whole table names first, else ``path``.

    Keys may be common words, as 'arm': after a name that the table lacks the message is about that one.
    """
    for part in path:
        data = data[part]
    if isinstance(data, dict):
        for word in re.findall(r"\w+", message):
            if word in data:
                return (*path, word)
            if "_" in word:
                break
    return path


def _sentence(item: ErrorDetails, model: type[BaseModel], place: Path) -> str:
    match item["type"]:
        case "extra_forbidden":
            return "unknown key" + did_you_mean(str(place[-1]), _keys_at(model, place[:-1]))
        case "missing":
            return "is missing"
        case "dict_type" | "model_type" | "model_attributes_type":
            return f"should be a table, not {_shown(item['input'])}"
        case "value_error":
            return item["msg"].removeprefix("Value error, ")
        case "too_short" | "too_long":
            count = len(item["input"]) if isinstance(item["input"], list | dict | str) else 0
            wanted = item["ctx"].get("min_length", item["ctx"].get("max_length"))
            return f"should have {wanted} entries, has {count}"
    text = item["msg"].removeprefix("Input ").replace("Field required", "is missing")
    return f"{text[:1].lower()}{text[1:]}, not {_shown(item['input'])}"


def _shown(value: Any) -> str:
    text = f"'{value}'" if isinstance(value, str) else str(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _keys_at(model: type[BaseModel], place: Path) -> list[str]:
    """The keys that are known where ``place`` leads from ``model``."""
    for part in place:
        if isinstance(part, int):
            continue
        info = next((f for n, f in model.model_fields.items() if part in (n, f.alias)), None)
        inner = _model_in(info.annotation) if info is not None else None
        if inner is not None:
            model = inner
    return [info.alias or name for name, info in model.model_fields.items()]


def _model_in(annotation: Any) -> type[BaseModel] | None:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next((m for m in map(_model_in, get_args(annotation)) if m is not None), None)
