"""Data sets whose numbers lead beyond what can be computed: one coded error for all solvers."""

from collections.abc import Callable, Sequence
from functools import wraps
from typing import ParamSpec, TypeVar

import numpy as np

from cell.errors import error

P = ParamSpec("P")
T = TypeVar("T")
Progress = Callable[[str, int, int], None]
LONG_S = 1.0  # a call that takes so long is not slow because caches are cold


def within_limits(solver: Callable[P, T]) -> Callable[P, T]:
    """``solver(path, ...)``; ``DATA_INVALID`` names the file where its numbers overflow.

    Matrices that are singular or overflow, quotients by zero and arrays larger than the memory: bounds on
    each number (``cell.formats.bounds``) do not rule out every combination of them.
    """

    @wraps(solver)
    def call(*args: P.args, **kwargs: P.kwargs) -> T:
        try:
            with np.errstate(all="ignore"):  # what comes of an overflow is judged, not each step to it
                return solver(*args, **kwargs)
        except (np.linalg.LinAlgError, ArithmeticError, MemoryError) as exc:
            raise _beyond(args, exc) from exc
        except ValueError as exc:
            if "infs or NaNs" not in str(exc):  # SciPy's words for a matrix that overflowed
                raise
            raise _beyond(args, exc) from exc

    return call


def _beyond(args: Sequence[object], exc: Exception) -> Exception:
    what = "needs more memory than there is" if isinstance(exc, MemoryError) else "cannot be computed with"
    return error(
        "DATA_INVALID",
        f"{args[0] if args else 'the data set'} {what} ({type(exc).__name__}: {exc}); look for numbers that "
        "no cell has, in another unit, or all equal",
    )
