"""Documents of results and plans: of which kind one is, and its model."""

import re
from collections.abc import Mapping
from typing import Any

from cell.errors import error
from cell.formats.result import Envelope, Result, read_as
from procedures.kind import KINDS, OUTSIDE, Kind, load


def kind_of(document: Mapping[str, Any], what: str = "result") -> Kind:
    """The kind that a result or a plan says it is of; ``KIND_UNKNOWN`` when there is none such."""
    name = document.get("kind")
    if isinstance(name, str):
        return kind_named(name, what)
    raise error("KIND_UNKNOWN", f"the {what} does not say its kind; known are {', '.join(KINDS)}")


def read_result(document: Mapping[str, Any], where: str = "the result") -> Envelope:
    """A result document as the model of its kind, as a plain ``Result`` when it has no answer.

    ``KIND_UNKNOWN``; ``RESULT_INVALID`` names the field that does not fit, and ``where``.
    """
    kind = kind_of(document)
    model: type[Envelope] = Result if document.get("result") is None else load(kind.result)
    return read_as(model, document, where)


def kind_named(name: str, what: str = "result") -> Kind:
    """The kind called ``name``: a shipped one, or ``"package.module:NAME"`` of a job of another package.

    ``KIND_UNKNOWN`` with the package that is missing, or with the kinds that there are. What a file says is
    never imported: kinds of other packages come with jobs that an entry point or the configuration names.
    """
    if name in KINDS:
        return KINDS[name]
    import procedures.registry  # noqa: F401, with it the jobs of installed packages bring their kinds

    if name in OUTSIDE:
        return OUTSIDE[name]
    said = f"the {what} is of kind '{name}'"
    if re.fullmatch(r"\w+(\.\w+)*:\w+", name) is None:
        raise error("KIND_UNKNOWN", f"{said}; known are {', '.join(KINDS)}")
    package = name.partition(":")[0].partition(".")[0]
    raise error(
        "KIND_UNKNOWN",
        f"{said}; install the package '{package}', or name its job in [job.NAME] procedure of the cell.toml",
    )
