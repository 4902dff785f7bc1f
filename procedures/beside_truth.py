"""A result beside the truth of a twin, which knows what nobody can know of a real cell."""

from collections.abc import Mapping
from dataclasses import dataclass, field

# 95 % limits of a length in space, of a direction and of one number, widened to 99.73 %: quantiles of
# chi-square with 3, 2 and 1 degrees of freedom.
SURE_POINT = 1.346
SURE_TILT = 1.405
SURE_SCALAR = 1.531


@dataclass(frozen=True)
class Judged:
    """A result beside the truth: ``stated`` by the job, ``off`` the truth, and the whole comparison.

    ``inside95``: whether each error is below the 95 % limit stated for it; None where none is stated.
    ``of95``: each error, by its name, in units of that limit.
    """

    good: bool
    text: str
    stated: str
    off: str
    inside95: bool | None = None
    of95: Mapping[str, float] = field(default_factory=dict)


def all_inside(of95: Mapping[str, float]) -> bool | None:
    """Whether all errors are below their limits, of ``Judged.of95``; None where there is no limit."""
    return all(share <= 1.0 for share in of95.values()) if of95 else None
