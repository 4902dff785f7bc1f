"""A result beside the truth of a twin, which knows what nobody can know of a real cell."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy.special import chdtri

# 95 % limits of a length in space, of a direction and of one number, widened to 99.73 %: quantiles of
# chi-square with 3, 2 and 1 degrees of freedom.
SURE_POINT = 1.346
SURE_TILT = 1.405
SURE_SCALAR = 1.531
_STATED, _SURE = 0.05, 0.0027  # of good results that a limit at 95 %, and at 99.73 %, leaves outside


@dataclass(frozen=True)
class Judged:
    """A result beside the truth: ``stated`` by the job, ``off`` the truth, and the whole comparison.

    ``inside95``: whether each error is below the 95 % limit stated for it; None where none is stated.
    ``of95``: each error, by its name, in units of that limit, and ``limits95`` the limits that have a unit:
    size and "m", "rad", "s", or "1" of a share. An error is its ``of95`` times its limit. ``uncovered`` has
    in words what the result says its limits do not cover.
    """

    good: bool
    text: str
    stated: str
    off: str
    inside95: bool | None = None
    of95: Mapping[str, float] = field(default_factory=dict)
    limits95: Mapping[str, tuple[float, str]] = field(default_factory=dict)
    uncovered: tuple[str, ...] = ()


def limit_of_worst(n: int, degrees: int = 3, *, sure: bool = False) -> float:
    """What the worst of ``n`` normal errors stays below in 95 % of all good results (99.73 % where ``sure``),
    in units of the 95 % limit of each, which is of ``degrees`` numbers.

    Of each a share of 0.05 / n may be beyond (Bonferroni). That is so whatever the errors have in common;
    where they are independent, it is 95.1 % at most and not 95 %.
    """
    beyond = _SURE if sure else _STATED
    return float(np.sqrt(chdtri(degrees, beyond / n) / chdtri(degrees, _STATED)))


def all_inside(of95: Mapping[str, float]) -> bool | None:
    """Whether all errors are below their limits, of ``Judged.of95``; None where there is no limit."""
    return all(share <= 1.0 for share in of95.values()) if of95 else None
