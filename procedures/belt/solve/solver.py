"""Belt tracking from an intercept data set: the one path of jobs, replay and ``cellward solve``."""

from functools import partial
from pathlib import Path

from cell.errors import error
from cell.formats.result import Result
from procedures.belt.result import InterceptResult
from procedures.belt.solve.answers import solve_adaptive, solve_classic
from procedures.belt.solve.data import load_intercept
from procedures.belt.solve.result import fill_result, refusal
from procedures.solving import Progress, within_limits
from procedures.timed import timed

ADAPTIVE, CLASSIC = "adaptive", "classic"


@within_limits
def solve_intercept(
    path: Path, *, method: str | None = None, progress: Progress | None = None, calls: int = 1
) -> InterceptResult | Result:
    """The result of an intercept data set: its JSON file, or a folder with one.

    ``method`` is ``adaptive`` (the default) or ``classic``. Each answer is made of data
    stamped at or before its query. ``calls``: how often it is solved, for those who compare its
    time. Bad input raises an ``InputError``; data that cannot determine the answers give a result with
    verdict ``fail``.
    """
    chosen = method or ADAPTIVE
    if chosen not in (ADAPTIVE, CLASSIC):
        raise error("ARGUMENT_INVALID", f"method is {method!r}; it must be {ADAPTIVE} or {CLASSIC}")
    loaded = load_intercept(Path(path))
    refused = refusal(loaded, chosen)
    if refused is not None:
        return refused
    solve = solve_adaptive if chosen == ADAPTIVE else solve_classic
    show = None if progress is None else partial(_show, progress, len(loaded.queries))
    solved, seconds = timed(lambda: solve(loaded, show), calls)
    return fill_result(loaded, solved, chosen, seconds)


def _show(progress: Progress, total: int, done: int) -> None:
    progress("solve", done, total)
