"""A result beside the truth of a twin, which knows what nobody can know of a real cell."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy.special import chdtri

# Of good results, the share that a limit at 95 % leaves outside, and the one beyond which a result is called
# wrong. A demo makes some 60 such comparisons: at 99.73 % one good demo of seven would fail, now one of 170.
STATED_BEYOND, WRONG_BEYOND = 0.05, 1e-4
SURE = "99.99 %"


def _widened(degrees: int) -> float:
    return float(np.sqrt(chdtri(degrees, WRONG_BEYOND) / chdtri(degrees, STATED_BEYOND)))


# 95 % limits of a length in space, of a direction and of one number, widened to ``SURE``.
SURE_POINT, SURE_TILT, SURE_SCALAR = _widened(3), _widened(2), _widened(1)
SURE_POSE = float(chdtri(6, WRONG_BEYOND))  # a squared Mahalanobis distance, of a shift and a turn
SURE_MODE = float(np.sqrt(chdtri(1, WRONG_BEYOND)))  # in standard deviations, of errors all in one direction


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
    """What the worst of ``n`` normal errors stays below in 95 % of all good results (``SURE`` of them where
    ``sure``), in units of the 95 % limit of each, which is of ``degrees`` numbers.

    Of each a share of 0.05 / n may be beyond (Bonferroni). That is so whatever the errors have in common;
    where they are independent, it is 95.1 % at most and not 95 %.
    """
    beyond = WRONG_BEYOND if sure else STATED_BEYOND
    return float(np.sqrt(chdtri(degrees, beyond / n) / chdtri(degrees, STATED_BEYOND)))


def all_inside(of95: Mapping[str, float]) -> bool | None:
    """Whether all errors are below their limits, of ``Judged.of95``; None where there is no limit."""
    return all(share <= 1.0 for share in of95.values()) if of95 else None
