"""What a PLC gives with the start of a job: argument registers as parameters of the run."""

import math
import struct
from collections.abc import Sequence

from cell.errors import error
from cell.procedure import Procedure
from procedures.documents import kind_named
from procedures.kind import Argument

PLACES = 3


def arguments_of(job: type[Procedure]) -> tuple[Argument, ...]:
    """The arguments that a job takes, as its kind declares them."""
    return kind_named(job.kind, "job").arguments if job.kind else ()


def given_params(job: type[Procedure], words: Sequence[int]) -> dict[str, str]:
    """The parameters of a start; ``words`` (3,) are the arguments as uint32, 0 where nothing is asked for.

    ``NOT_IN_VERSION`` for one that the job does not take, ``ARGUMENT_INVALID`` for a number that stands for
    nothing. Whether a number is within its bounds is told when the run is made.
    """
    taken = {argument.place: argument for argument in arguments_of(job)}
    params = {}
    for place, word in enumerate(words, 1):
        if word and place not in taken:
            raise error("NOT_IN_VERSION", f"{job.name} takes no argument_{place}, which must be 0")
        if word and (text := _text(taken[place], word)):
            params[taken[place].key] = text
    return params


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
