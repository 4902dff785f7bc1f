"""How a demo ends: the result of its run beside the truth, the report, and the exit code."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from cell.store.runs import load_run
from daemon.cli.failures import FAILED, OK
from daemon.cli.output import out, say
from daemon.cli.result_text import result_text
from daemon.demo.verdict import judge, judgement_text


def conclude(runs: Path, run_id: int, truth: Mapping[str, Any]) -> int:
    """Print everything; 0 only for a complete run, a verdict other than fail, and an error within limits."""
    run = load_run(runs, run_id)
    end, result = run.read_end() or {"outcome": "interrupted"}, run.read_result()
    if end["outcome"] != "complete" or result is None:
        failure = end.get("error")
        why = f": {failure['text']} ({failure['code']}). {failure['hint']}" if failure else ""
        say(f"run {run_id} ended {end['outcome']}{why}\nIts journal is in {run.path}")
        return FAILED
    out(result_text(result))
    judgement = judge(result, truth)
    out("\nBeside the twin's truth:")
    out(judgement_text(judgement, result["result"]))
    report = run.path / "report.html"
    out(f"report: {report if report.exists() else f'none was drawn; the journal in {run.path} says why'}")
    return OK if result["verdict"] != "fail" and judgement.good else FAILED
