"""On which line of a TOML file a key stands; ``tomllib`` checks and reads a file but keeps no positions."""

import re
from collections.abc import Callable

Path = tuple[str | int, ...]

_BLANK = re.compile(r"(?:[ \t\r\n]|#[^\n]*)*")
_BARE = re.compile(r"[A-Za-z0-9_-]+")
_STRING = re.compile(r'"""(?:\\.|[^\\])*?"{3,5}|\'\'\'.*?\'{3,5}|"(?:\\.|[^"\\\n])*"|\'[^\'\n]*\'', re.DOTALL)
_ATOM = re.compile(r"[^,\]}#\n]+")


def locate(text: str) -> dict[Path, int]:
    """The line, from 1, of every key, table and array element in ``text``, which is valid TOML."""
    return _Locator(text).document()


def line_of(lines: dict[Path, int], path: Path) -> int:
    """The line of ``path``, or of the closest thing around it that is in the file; 1 if nothing is."""
    for length in range(len(path), 0, -1):
        if path[:length] in lines:
            return lines[path[:length]]
    return 1


class _Locator:
    """A recursive descent that follows the grammar only as far as it moves positions."""

    def __init__(self, text: str) -> None:
        self._text, self._at = text, 0
        self._lines: dict[Path, int] = {}
        self._elements: dict[Path, int] = {}  # how many [[tables]] of this name there were

    def document(self) -> dict[Path, int]:
        table: Path = ()
        while self._skip_blank():
            if self._text[self._at] == "[":
                table = self._header()
            else:
                self._key_value(table)
        return self._lines

    def _header(self) -> Path:
        start = self._at
        array = self._text.startswith("[[", start)
        self._at += 2 if array else 1
        path: Path = ()
        names = self._dotted_key()
        for depth, name in enumerate(names, 1):
            path += (name,)
            if array and depth == len(names):
                self._elements[path] = self._elements.get(path, -1) + 1
            if path in self._elements:
                path += (self._elements[path],)
        self._mark(path, start)
        self._at += 2 if array else 1
        return path

    def _key_value(self, table: Path) -> None:
        start = self._at
        path = table + tuple(self._dotted_key())
        self._mark(path, start)
        self._at += 1  # the equals sign
        self._value(path)

    def _dotted_key(self) -> list[str]:
        names = []
        while True:
            self._skip_blank()
            match = _BARE.match(self._text, self._at) or _STRING.match(self._text, self._at)
            if match is None:
                raise ValueError(f"no key at position {self._at}")
            self._at = match.end()
            names.append(match[0].strip("\"'"))
            self._skip_blank()
            if self._text[self._at] != ".":
                return names
            self._at += 1

    def _value(self, path: Path) -> None:
        self._skip_blank()
        match self._text[self._at]:
            case "[":
                self._bracketed("]", lambda number: self._element((*path, number)))
            case "{":
                self._bracketed("}", lambda _: self._key_value(path))
            case "'" | '"' if (string := _STRING.match(self._text, self._at)) is not None:
                self._at = string.end()
            case _ if (atom := _ATOM.match(self._text, self._at)) is not None:
                self._at = atom.end()

    def _element(self, path: Path) -> None:
        self._mark(path, self._at)
        self._value(path)

    def _bracketed(self, end: str, item: Callable[[int], None]) -> None:
        self._at += 1
        number = 0
        while self._skip_blank() and self._text[self._at] != end:
            if self._text[self._at] == ",":
                self._at += 1
                continue
            item(number)
            number += 1
        self._at += 1

    def _skip_blank(self) -> bool:
        """Go on to the next sign of meaning; False at the end of the text."""
        match = _BLANK.match(self._text, self._at)
        self._at = match.end() if match is not None else self._at
        return self._at < len(self._text)

    def _mark(self, path: Path, at: int) -> None:
        line = self._text.count("\n", 0, at) + 1
        for length in range(1, len(path) + 1):
            self._lines.setdefault(path[:length], line)
