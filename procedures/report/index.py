"""The index of reports: one file that lists runs with what each came to, who decided and who signed."""

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from urllib.parse import quote

from cell.store.files import write_atomic
from cell.store.run_list import REPORT_FILE, ListedRun
from cell.store.signatures import Checked
from procedures.report.cover import TWIN, moment, signed_content
from procedures.report.html import Html, absent, bullets, document, el, join, note, section, table
from procedures.report.numbers import DASH

FILE_NAME = "reports.html"
HEAD = ("run", "job", "tool", "started", "verdict", "main figure", "decision", "signed", "report")
_DECIDED = {
    "proposed": "waits for a decision",
    "accepted": "accepted",
    "committed": "accepted",
    "superseded": "accepted, replaced since",
    "rejected": "rejected",
    "rolled-back": "rolled back",
}


@dataclass(frozen=True)
class IndexedCell:
    """The runs of one cell, below the folder ``runs``."""

    name: str
    runs: Path
    listed: Sequence[ListedRun]


def write_index(cells: Sequence[IndexedCell], path: Path) -> Path:
    """Write the index of ``cells`` to ``path``, with links that hold while the folders keep their places.

    ``DISK_FULL``, ``DISK_FAILED``.
    """
    shown = [_cell(cell, path.absolute().parent) for cell in cells]
    twins = any(run.twin for cell in cells for run in cell.listed)
    made = datetime.now(UTC).isoformat()
    body = join(
        [
            el("header", el("h1", "Reports"), el("p", f"as of {moment(made)}")),
            el("p", TWIN.replace("this report", "the runs marked TWIN"), class_="twin") if twins else None,
            *shown,
            note(
                "The verdict is that of the job, the decision that of a person. A signature names who stands "
                "for the record of a run; 'cellward verify RUN' solves it again."
            ),
        ]
    )
    write_atomic(path, document("Reports", body, ""))
    return path


def _cell(cell: IndexedCell, beside: Path) -> Html:
    rows = (_row(run, cell.runs, beside) for run in cell.listed)
    return section(f"Cell {cell.name}", table(HEAD, rows) if cell.listed else absent("There are no runs."))


def _row(run: ListedRun, runs: Path, beside: Path) -> tuple[object, ...]:
    figure = run.figure
    return (
        str(run.run_id),
        join([run.job, " ", el("b", "TWIN") if run.twin else None]),
        run.tool or DASH,
        moment(run.started),
        _verdict(run),
        DASH if figure is None else join([el("b", figure.text()), " ", figure.words]),
        _lines(_decision(row) for row in run.decided),
        _lines(signed(each) for each in run.signatures),
        _link(run, runs, beside),
    )


def _verdict(run: ListedRun) -> Html:
    """The verdict; of a run that did not complete, how it ended and why."""
    if run.outcome == "complete":
        return el("b", run.verdict or DASH, class_=run.verdict or "")
    how = run.outcome or "goes on, or was interrupted"
    return join([el("b", how, class_="fail" if run.outcome else ""), f": {run.cause}" if run.cause else None])


def _decision(row: Mapping[str, Any]) -> Html:
    words = _DECIDED.get(row["state"], row["state"])
    version = f" as version {row['version']}" if row["version"] is not None else ""
    who = f" by {row['who']} on {moment(row['decided'])}" if row["who"] else ""
    why = f": {row['why']}" if row["why"] else ""
    return join([el("b", words), f"{version}{who}{why} (result {row['id']}, {row['name']})"])


def signed(checked: Checked) -> Html:
    """One signature in a sentence, and what is not as it was signed."""
    by = checked.signature
    if by is None:
        return el("b", f"the signatures cannot be read: {'; '.join(checked.changed)}", class_="fail")
    content = signed_content(checked.changed, by.digest)
    return join([f"signed by {by.name} ({by.role}) on {moment(by.at)}, ", content])


def _lines(lines: Iterable[Html]) -> Html | str:
    found = list(lines)
    return bullets(found) if len(found) > 1 else join(found) or DASH


def _link(run: ListedRun, runs: Path, beside: Path) -> Html:
    if not run.report:
        return el("code", f"cellward report {run.run_id}")
    where = os.path.relpath(runs / run.folder / REPORT_FILE, beside)
    return el("a", "report", href=quote(where))
