"""What became of each step of the demo, and the table that closes it."""

from collections.abc import Sequence
from dataclasses import dataclass

from daemon.cli.output import out
from procedures.words import table


@dataclass(frozen=True)
class Row:
    """One line of the closing table; ``code`` is what the step makes of the demo's exit code."""

    job: str
    stated: str
    off: str
    verdict: str
    code: int


def closing_table(rows: Sequence[Row]) -> int:
    """Print what each step came to; the exit code of the whole demo."""
    lines = [(row.job, row.stated, row.off, row.verdict) for row in rows]
    out("")
    out(table(("job", "stated by the job", "off the twin's truth", "verdict"), lines))
    return max((row.code for row in rows), default=0)
