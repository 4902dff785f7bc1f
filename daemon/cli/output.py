"""Writing to the terminal: results on stdout, messages on stderr, plain text that survives a pipe."""

import json
import shutil
import sys
import textwrap
from collections.abc import Iterable, Sequence
from typing import Any

from procedures.words import table


def out(text: str = "") -> None:
    """One line of the result."""
    sys.stdout.write(text + "\n")


def say(text: str) -> None:
    """One line to the person at the keyboard; never part of the result."""
    sys.stdout.flush()
    sys.stderr.write(text + "\n")


def out_json(value: Any) -> None:
    """The result for programs: one JSON document, SI units."""
    out(json.dumps(value, indent=2, ensure_ascii=False, default=str))


def terminal_width() -> int | None:
    """Characters in a line of the terminal; None where the result goes elsewhere, which gets whole lines."""
    return shutil.get_terminal_size().columns if sys.stdout.isatty() else None


def out_table(header: Sequence[str], rows: Iterable[Sequence[Any]], give_way: Sequence[str]) -> None:
    """A table; where a terminal is too narrow, columns are told below each row, wrapped between words.

    As few as will do: those that ``give_way``, in this order, then the others from the right.
    """
    width = terminal_width()
    if width is None:
        out(table(header, rows))
        return
    lines = [[cell if cell is None else " ".join(str(cell).split()) for cell in row] for row in rows]
    shown, below = list(range(len(header))), [header.index(name) for name in give_way]
    below += [column for column in shown[:0:-1] if column not in below]
    moved = 0
    while True:
        text = table([header[c] for c in shown], ([row[c] for c in shown] for row in lines)).split("\n")
        if moved == len(below) or max(map(len, text)) <= width:
            break
        shown.remove(below[moved])
        moved += 1
    out(text[0])
    for line, row in zip(text[1:], lines, strict=True):
        out(line)
        for column in sorted(below[:moved]):
            if row[column]:
                out(_below(f"{header[column]}: {row[column]}", width))


def _below(text: str, width: int) -> str:
    """Wrapped with indents; no word is cut, and so no figure."""
    return textwrap.fill(
        text,
        width,
        initial_indent="  ",
        subsequent_indent="    ",
        break_long_words=False,
        break_on_hyphens=False,
    )
