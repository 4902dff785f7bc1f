"""What became of each step of the demo: the table and the index of reports that close it."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from cell.errors import CellError
from daemon.cli.failures import FAILED
from daemon.cli.output import out, say
from daemon.report_index import CellState, write_report_index
from procedures.report.index import FILE_NAME
from procedures.words import table


@dataclass(frozen=True)
class Row:
    """One line of the closing table; ``code`` is what the step makes of the demo's exit code.

    ``twin`` is where it ran, on objects where it is ``virtual``; ``ideal`` is ``off`` in its ideal world.
    """

    job: str
    stated: str
    off: str
    verdict: str
    code: int
    twin: str = ""
    virtual: bool = False
    ideal: str = ""


def close_demo(rows: Sequence[Row], twins: Sequence[CellState], folder: Path) -> int:
    """Print what each step came to and where the index of all reports is; the exit code of the demo."""
    code = closing_table(rows)
    try:
        out(f"\nAll reports: {write_report_index(twins, folder / FILE_NAME)}")
    except CellError as exc:  # the figures above hold without it
        say(f"The index of the reports could not be written: {exc}. {exc.hint}")
        return max(code, FAILED)
    return code


def closing_table(rows: Sequence[Row]) -> int:
    """Print what each step came to; the exit code that this makes."""
    times = Counter(row.job for row in rows)
    head = ["job", "stated by the job", "off the twin's truth", "off it in an ideal world", "verdict"]
    lines = [[_named(row, times[row.job] > 1), row.stated, row.off, row.ideal, row.verdict] for row in rows]
    if not any(row.ideal for row in rows):
        head, *lines = [line[:3] + line[4:] for line in (head, *lines)]
    out("")
    out(table(head, lines))
    return max((row.code for row in rows), default=0)


def beside_ideal(rows: Sequence[Row], ideal: Sequence[Row]) -> list[Row]:
    """``rows`` with what became of each in the ``ideal`` world of its twin; one that was not good there is no
    good row either."""
    left, joined = list(ideal), []
    for row in rows:
        # Of a job that runs twice in one twin, in the order of both.
        kind = next((one for one in left if (one.job, one.twin) == (row.job, row.twin)), None)
        if kind is not None:
            left.remove(kind)
            told = f"{kind.off}: {kind.verdict}" if kind.code else kind.off
            row = replace(row, ideal=told, code=max(row.code, kind.code))
        joined.append(row)
    return joined


def _named(row: Row, several: bool) -> str:
    """The job, with its twin where there are ``several`` rows of it."""
    where = [row.twin] * (several and bool(row.twin)) + ["virtual"] * row.virtual
    return f"{row.job} ({', '.join(where)})" if where else row.job
