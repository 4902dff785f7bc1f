"""How a demo ends: the result of its run beside the truth, the report, and the exit code."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from cell.store.files import read_json, to_json, write_atomic
from cell.store.runs import load_run
from daemon.cli.failures import FAILED, OK
from daemon.cli.output import out, say
from daemon.demo.closing import Row
from daemon.words.result_text import result_text
from procedures.beside_truth import Judged
from procedures.documents import kind_of, read_result
from procedures.kind import load
from procedures.report.source import RESULT_FILE, TRUTH_FILE
from procedures.report.write import FILE_NAME as REPORT_FILE
from procedures.report.write import layout_of, write_report


def conclude(runs: Path, run_id: int, truth: Mapping[str, Any], finds_fault: bool = False) -> Row:
    """Print everything; good only for a complete run, a verdict other than fail, an error within limits.

    A run that ``finds_fault`` is good only with a verdict of fail: its twin has a fault.
    """
    run = load_run(runs, run_id)
    end, result = run.read_end() or {"outcome": "interrupted"}, run.read_result()
    if end["outcome"] != "complete" or result is None:
        failure = end.get("error")
        why = f": {failure['text']} ({failure['code']}). {failure['hint']}" if failure else ""
        say(f"run {run_id} ended {end['outcome']}{why}\nIts journal is in {run.path}")
        return Row(run.job, "-", "-", f"ended {end['outcome']}{why}", FAILED)
    out(result_text(result))
    judged = None
    if result["result"] is not None:
        judged = beside_truth(result, truth, run.path)
        _into_report(run.path, truth)
        out("\nBeside the twin's truth:")
        out(judged.text)
    report = run.path / REPORT_FILE
    out(f"report: {report if report.exists() else f'none was drawn; the journal in {run.path} says why'}")
    if judged is None:
        return Row(run.job, "no answer", "-", str(result["verdict"]), FAILED)
    good = (result["verdict"] == "fail") == finds_fault and judged.good
    verdict = f"{result['verdict']}{', as it should' if finds_fault and result['verdict'] == 'fail' else ''}"
    words = f"{verdict}, {'agrees with' if judged.good else 'NOT consistent with'} the truth"
    again = len((result.get("inputs") or {}).get("steps_taken_again") or ())
    words += f"; {again} steps taken again" if again else ""
    return Row(run.job, judged.stated, judged.off, words, OK if good else FAILED)


def _into_report(folder: Path, truth: Mapping[str, Any]) -> None:
    """Leave the truth beside the result, and draw a report again that shows it."""
    if (folder / REPORT_FILE).exists() and layout_of(read_json(folder / RESULT_FILE)).shows_truth:
        write_atomic(folder / TRUTH_FILE, to_json(truth))
        write_report(folder)


def beside_truth(result: Mapping[str, Any], truth: Mapping[str, Any], folder: Path) -> Judged:
    """The answer of the run in ``folder`` beside the twin's truth, for a kind that can be judged by it."""
    judged: Judged = load(kind_of(result).truth)(read_result(result), truth, folder)
    return judged
