"""Rows of numbers of the last while, which a running job leaves for whoever draws them.

Adding a row is a tuple at the end of a bounded list, so a loop that has to keep time can do it at every
step. Readers ask for what came after the rows that they have, a bounded number at a time.
"""

from collections import deque
from collections.abc import Sequence
from itertools import islice

MOST_ROWS = 3000


class Trace:
    """``columns`` name what a row holds, with the unit at the end of the name. The oldest rows are lost."""

    def __init__(self, columns: Sequence[str], most: int = MOST_ROWS) -> None:
        self.columns = tuple(columns)
        self._rows: deque[tuple[float, ...]] = deque(maxlen=most)
        self._end = 0

    def add(self, *row: float) -> None:
        """One row, a number for each column."""
        self._rows.append(row)
        self._end += 1

    def since(self, number: int, most: int) -> tuple[int, list[tuple[float, ...]]]:
        """Up to ``most`` rows from row ``number`` on, counted from 0 at the job's begin; the number after
        them is what to ask for next. A reader that was too slow goes on with the oldest row there is."""
        oldest = self._end - len(self._rows)
        begin = min(max(number, oldest), self._end)
        rows = list(islice(self._rows, begin - oldest, begin - oldest + most))
        return begin + len(rows), rows
