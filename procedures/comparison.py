"""Do two results differ by more than their uncertainties explain? The command line and the page tell it."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from calibration.odds import FALSE_ALARM
from cell.errors import error
from procedures.documents import kind_of, read_result
from procedures.kind import KINDS, load
from procedures.words import mm


@dataclass(frozen=True)
class Compared:
    """One figure of both results in its SI ``unit``; ``of`` is the pose that it belongs to, if any.

    ``difference`` is the second less the first, and ``sigma`` its standard uncertainty, None where none is
    stated. ``first`` and ``second`` are None where only their difference has a meaning.
    """

    name: str
    unit: str
    difference: float
    sigma: float | None = None
    first: float | None = None
    second: float | None = None
    of: str = ""


class Comparison(Protocol):
    """The second result against the first, as figures and in words."""

    def as_dict(self) -> dict[str, Any]: ...
    def rows(self) -> list[Compared]: ...
    def text(self, first: str, second: str) -> str: ...


def compare_results(
    first: Mapping[str, Any], second: Mapping[str, Any], *, false_alarm: float | None = None
) -> Comparison:
    """Compare two result documents; ``ARGUMENT_INVALID`` when they do not hold the same kind of answer,
    or are one and the same.

    ``false_alarm`` is how often results that differ by chance alone are called different, ``FALSE_ALARM`` if
    it is None; ``ARGUMENT_INVALID`` where it is no chance, or the kind is compared without a test.
    """
    if false_alarm is not None and not 0.0 < false_alarm < 1.0:
        raise error(
            "ARGUMENT_INVALID", f"the false alarm {false_alarm:g} is no chance; give one between 0 and 1"
        )
    kind, other = kind_of(first), kind_of(second)
    if kind != other:
        raise error(
            "ARGUMENT_INVALID", f"one run holds a {kind.name} result, the other a {other.name} result"
        )
    if not kind.compare:
        compared = ", ".join(k.name for k in KINDS.values() if k.compare)
        raise error(
            "ARGUMENT_INVALID",
            f"results of kind {kind.name} have no comparison; of the shipped kinds {compared} have one",
        )
    if not (first.get("result") and second.get("result")):
        raise error("ARGUMENT_INVALID", f"a {kind.name} result without an answer cannot be compared")
    if first == second:
        raise error("ARGUMENT_INVALID", "both runs hold one and the same result; give two runs that differ")
    chance = FALSE_ALARM if false_alarm is None else false_alarm
    found: Comparison = load(kind.compare)(read_result(first), read_result(second), chance)
    if false_alarm is not None and "false_alarm" not in found.as_dict():
        raise error(
            "ARGUMENT_INVALID", f"{kind.name} results are compared without a test; give no false alarm"
        )
    return found


def odds_line(false_alarm: float, change: str, detectable_m: float) -> str:
    """The odds of a comparison in words; ``detectable_m`` is the size of a ``change`` that is found."""
    return (
        f"chance alone goes beyond it in 1 of {1.0 / false_alarm:.4g} comparisons, a {change} of "
        f"{mm(detectable_m, 4)} in 99 of 100"
    )
