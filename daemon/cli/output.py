"""Writing to the terminal: results on stdout, messages on stderr, plain text that survives a pipe."""

import json
import sys
from typing import Any


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
