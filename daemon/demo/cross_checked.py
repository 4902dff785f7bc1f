"""The cross check of the demo: runs of one twin against each other, and its verdict beside the truth."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from cell.errors import CellError
from cell.store.runs import load_run
from daemon.cli.failures import FAILED, OK
from daemon.cli.output import out, say
from daemon.demo.closing import Row
from daemon.words.result_text import result_text
from procedures.cross_check.result import CrossCheckResult
from procedures.cross_check.solver import check_cell
from procedures.cross_check.truth import judge_change
from procedures.report.write import FILE_NAME, write_report

CAPTURE, BEAMS, TOUCH = "cone-capture", "laser-check", "touch-test"
NAME = "cross-check"
Done = tuple[str, Path, int, Mapping[str, Any]]
"""Job, folder of runs, number, and the twin's truth after it."""


def cross_check(runs: Sequence[Done], folder: Path) -> Row:
    """Print which part has changed between the first and the last capture of ``runs``, as beams and touched
    corners tell as well, and the truth beside; the report goes into ``folder``."""
    captures = [run for run in runs if run[0] == CAPTURE]
    then, now = captures[0], captures[-1]
    measured = [next((_folder(run) for run in runs if run[0] == job), None) for job in (BEAMS, TOUCH)]
    try:
        result = check_cell(_folder(then), _folder(now), measured[0], touch=measured[1])
    except CellError as failure:  # a run before it came to nothing
        say(f"{failure}. {failure.hint}")
        return Row(NAME, "-", "-", f"not done: {failure}", FAILED)
    document = result.signed().as_json()
    out(result_text(document))
    if not isinstance(result, CrossCheckResult):
        return Row(NAME, "no answer", "-", str(result.verdict), FAILED)
    judged = judge_change(result, then[-1], now[-1])
    out("\nBeside the twin's truth:")
    out(judged.text)
    out(f"report: {write_report(document, folder / FILE_NAME)}")
    words = f"{'agrees with' if judged.good else 'NOT consistent with'} the truth"
    return Row(NAME, judged.stated, judged.off, words, OK if judged.good else FAILED)


def _folder(run: Done) -> Path:
    return load_run(run[1], run[2]).path
