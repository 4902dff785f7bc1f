"""Coded errors: every failure that a person or a PLC can meet has a number, a text and a hint.

The catalogue (``catalogue.toml``) is the single list; the class of an error decides the reaction, so a
caller never guesses. ``error("ARM_PROTECTIVE_STOP", "safety mode 3")`` makes the right class.
"""

import tomllib
from contextlib import suppress
from dataclasses import dataclass
from enum import StrEnum
from functools import cache
from importlib.resources import files
from typing import TypeVar

T = TypeVar("T")


class Reaction(StrEnum):
    """What the daemon does when an error of this kind reaches it."""

    RETRY = "retry"  # a link or a device: the supervisor tries again
    ABORT = "abort"  # the job ends
    LATCH = "latch"  # the job ends and nothing moves before an operator resets
    INPUT = "input"  # the person at the keyboard has to change something
    REFUSE = "refuse"  # the request is not possible now; nothing happened
    INTERNAL = "internal"  # a defect of ours


@dataclass(frozen=True)
class CatalogueEntry:
    """One line of the catalogue."""

    name: str
    code: int
    reaction: Reaction
    text: str
    hint: str


@cache
def catalogue() -> dict[str, CatalogueEntry]:
    """All known errors by name."""
    raw = tomllib.loads(files("cell").joinpath("catalogue.toml").read_text("utf-8"))
    return {
        name: CatalogueEntry(name, int(e["code"]), Reaction(e["reaction"]), e["text"], e["hint"])
        for name, e in raw.items()
    }


_REFUSED_BIT = 0x8000  # in a PLC's result register, before the code


def find_entry(code: str | int) -> CatalogueEntry | None:
    """The entry for a name or a number, or None. A number may be as a PLC shows it: hexadecimal (0x9771), or
    with the bit of a refusal (38769)."""
    text = str(code)
    with suppress(ValueError):
        number = int(text, 0)
        text = str(number - _REFUSED_BIT if number > _REFUSED_BIT else number)
    for entry in catalogue().values():
        if text.upper() == entry.name or text == str(entry.code):
            return entry
    return None


class CellError(Exception):
    """A coded error. ``name`` and ``code`` come from the catalogue, ``detail`` says what was seen."""

    reaction = Reaction.INTERNAL

    def __init__(self, name: str, detail: str = "") -> None:
        entry = catalogue()[name]
        self.name, self.code, self.hint, self.detail = name, entry.code, entry.hint, detail
        super().__init__(f"{entry.text}: {detail}" if detail else entry.text)

    def __reduce__(self) -> tuple[object, tuple[str, str]]:
        return error, (self.name, self.detail)

    def as_dict(self) -> dict[str, object]:
        """For journals, results and ``--json``."""
        return {"code": self.code, "name": self.name, "text": str(self), "hint": self.hint}


class RetryError(CellError):
    """A link or device failed; the supervisor reconnects, a job that used it ends."""

    reaction = Reaction.RETRY


class AbortError(CellError):
    """The job cannot go on."""

    reaction = Reaction.ABORT


class LatchError(CellError):
    """The job ends and motion stays refused until an operator resets."""

    reaction = Reaction.LATCH


class InputError(CellError):
    """A config, file or argument is wrong."""

    reaction = Reaction.INPUT


class RefusedError(CellError):
    """The request cannot be served now; nothing happened."""

    reaction = Reaction.REFUSE


class InternalError(CellError):
    """A defect of the program."""


_CLASSES: dict[Reaction, type[CellError]] = {
    c.reaction: c for c in (RetryError, AbortError, LatchError, InputError, RefusedError, InternalError)
}


def error(name: str, detail: str = "") -> CellError:
    """The error ``name`` from the catalogue, in the class that its reaction asks for."""
    return _CLASSES[catalogue()[name].reaction](name, detail)


def present(value: T | None, what: str) -> T:
    """``value``, where its type cannot say that it is there; ``INTERNAL`` names ``what`` is missing."""
    if value is None:
        raise error("INTERNAL", f"there is no {what}")
    return value
