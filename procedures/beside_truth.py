"""A result beside the truth of a twin, which knows what nobody can know of a real cell."""

from dataclasses import dataclass

# 95 % limits of a length in space, of a direction and of one number, widened to 99.73 %: quantiles of
# chi-square with 3, 2 and 1 degrees of freedom.
SURE_POINT = 1.346
SURE_TILT = 1.405
SURE_SCALAR = 1.531


@dataclass(frozen=True)
class Judged:
    """A result beside the truth: ``stated`` by the job, ``off`` the truth, and the whole comparison.

    ``inside95``: whether each error is below the 95 % limit stated for it; None where none is stated.
    """

    good: bool
    text: str
    stated: str
    off: str
    inside95: bool | None = None
