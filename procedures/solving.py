"""What all solvers share: data that determine no answer, and numbers that cannot be computed with."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import wraps
from typing import Any, ParamSpec, TypeVar

import numpy as np
from pydantic import ValidationError

from calibration.refusal import Refusal
from cell.errors import error
from cell.formats.result import Inputs, Result, Warning_

P = ParamSpec("P")
T = TypeVar("T")
Progress = Callable[[str, int, int], None]


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
        except ValidationError as exc:
            first = exc.errors(include_url=False)[0]
            if first["type"] != "finite_number":  # a defect of the solver, and not of its data
                raise
            raise _beyond(args, ArithmeticError(f"{'.'.join(map(str, first['loc']))} has no size")) from exc
        except ValueError as exc:
            if "infs or NaNs" not in str(exc):  # SciPy's words for a matrix that overflowed
                raise
            raise _beyond(args, exc) from exc

    return call


def require_no_method(kind: str, method: str | None) -> None:
    """``ARGUMENT_INVALID`` for a ``method`` that was asked of a ``kind`` with a single one."""
    if method is not None:
        raise error("ARGUMENT_INVALID", f"method is {method!r}; {kind} has one only, leave it out")


def refused(
    kind: str,
    refusal: Refusal,
    warnings: Iterable[tuple[str, str]],
    inputs: Mapping[str, Any] | Inputs,
    **observability: Any,
) -> Result:
    """The result of data that determine no answer; ``observability`` says what else is known of them."""
    return Result(
        kind=kind,
        verdict="fail",
        reasons=[str(refusal)],
        warnings=Warning_.each(warnings),
        result=None,
        observability={"refused": refusal.name, **observability},
        inputs=inputs if isinstance(inputs, Inputs) else Inputs.model_validate(inputs),
    )


def _beyond(args: Sequence[object], exc: Exception) -> Exception:
    what = "needs more memory than there is" if isinstance(exc, MemoryError) else "cannot be computed with"
    return error(
        "DATA_INVALID",
        f"{args[0] if args else 'the data set'} {what} ({type(exc).__name__}: {exc}); look for numbers that "
        "no cell has, in another unit, or all equal",
    )
