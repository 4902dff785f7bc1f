"""What a PLC gives with the start of a job: argument registers as parameters of the run."""

import math
import struct
from collections.abc import Mapping, Sequence

from cell.errors import error
from cell.procedure import Procedure
from daemon.tools import ARGUMENT
from procedures.documents import kind_named
from procedures.kind import Argument

PLACES = 3
TOOL_PLACE = 3  # of the tool's changer number


def arguments_of(job: type[Procedure]) -> tuple[Argument, ...]:
    """The arguments that a job takes, as its kind declares them."""
    return kind_named(job.kind, "job").arguments if job.kind else ()


def given_params(
    job: type[Procedure], words: Sequence[int], tools: Mapping[int, str] | None = None
) -> dict[str, str]:
    """The parameters of a start; ``words`` (3,) are the arguments as uint32, 0 where nothing is asked for.

    ``tools`` are those of the cell by their changer number, which is the third argument of every job that has
    none of its own there. ``NOT_IN_VERSION`` for an argument that the job does not take, ``ARGUMENT_INVALID``
    for a number that stands for nothing. Whether one is within its bounds is told when the run is made.
    """
    taken = {argument.place: argument for argument in arguments_of(job)}
    params = {}
    for place, word in enumerate(words, 1):
        if word and tools and place == TOOL_PLACE and place not in taken:
            params[ARGUMENT] = _tool(word, tools)
            continue
        if word and place not in taken:
            raise error("NOT_IN_VERSION", f"{job.name} takes no argument_{place}, which must be 0")
        if word and (text := _text(taken[place], word)):
            params[taken[place].key] = text
    return params


def _tool(number: int, tools: Mapping[int, str]) -> str:
    if number not in tools:
        known = ", ".join(f"{changer} {name}" for changer, name in sorted(tools.items()))
        raise error("ARGUMENT_INVALID", f"argument_{TOOL_PLACE} (tool) is {number}; there is {known}")
    return tools[number]


def _text(argument: Argument, word: int) -> str:
    """The parameter as it would be typed; empty for 0.0, which has a sign bit."""
    where = f"argument_{argument.place} ({argument.key})"
    if argument.type == "float32":
        number: float = struct.unpack(">f", struct.pack(">I", word))[0]
        if not math.isfinite(number):
            raise error("ARGUMENT_INVALID", f"{where} is no number")
        return repr(number) if number else ""
    if not argument.words:
        return str(word)
    if word > len(argument.words):
        known = ", ".join(f"{number} {name}" for number, name in enumerate(argument.words, 1))
        raise error("ARGUMENT_INVALID", f"{where} is {word}; there is {known}")
    return argument.words[word - 1]
