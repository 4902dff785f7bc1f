"""Belt tracking from an intercept data set: the one path of jobs, replay and ``cellward solve``."""

import time
from functools import partial
from pathlib import Path

from cell.errors import error
from cell.formats.result import Result
from procedures.belt.result import InterceptResult
from procedures.belt.solve.answers import solve_adaptive, solve_classic
from procedures.belt.solve.data import load_intercept
from procedures.belt.solve.result import fill_result, refusal
from procedures.solving import LONG_S, Progress, within_limits

ADAPTIVE, CLASSIC = "adaptive", "classic"


@within_limits
def solve_intercept(
    path: Path, *, method: str | None = None, progress: Progress | None = None
) -> InterceptResult | Result:
    """The result of an intercept data set: its JSON file, or a folder with one.

    ``method`` is ``adaptive`` (the default) or ``classic``. Each answer is made of data
    stamped at or before its query. Bad input raises an ``InputError``; data that cannot determine the
    answers give a result with verdict ``fail``.
    """
    chosen = method or ADAPTIVE
    if chosen not in (ADAPTIVE, CLASSIC):
        raise error("ARGUMENT_INVALID", f"method is {method!r}; it must be {ADAPTIVE} or {CLASSIC}")
    loaded = load_intercept(Path(path))
    refused = refusal(loaded, chosen)
    if refused is not None:
        return refused
    solve = solve_adaptive if chosen == ADAPTIVE else solve_classic
    count = len(loaded.queries)
    seconds = []
    for begin in (0, count):  # two calls: the first one pays for cold caches
        start = time.perf_counter()
        solved = solve(loaded, None if progress is None else partial(_show, progress, begin, 2 * count))
        seconds.append(time.perf_counter() - start)
        if seconds[0] > LONG_S:
            break
    return fill_result(loaded, solved, chosen, min(seconds))


def _show(progress: Progress, before: int, total: int, done: int) -> None:
    progress("solve", before + done, total)
