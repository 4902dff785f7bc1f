"""Following a run to its end from outside the daemon."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import typer

from cell.errors import CellError, catalogue, error
from daemon.cli.failures import FAILED, exit_code_of, tell
from daemon.cli.history import load
from daemon.cli.next_step import next_commands
from daemon.cli.output import out, out_json, say
from daemon.cli.progress import ProgressBar
from daemon.cli.status_text import job_text
from daemon.control_client import ControlClient


def follow(daemon: ControlClient, run_id: int) -> dict[str, Any]:
    """Show the progress of a run on stderr until it ends; its entry in ``last_run``.

    Ctrl-C ends the watching, never the job.
    """
    with ProgressBar() as bar:
        try:
            return _watch(daemon, run_id, bar)
        except KeyboardInterrupt:
            say(f"Run {run_id} goes on; 'cellward abort' stops it.")
            raise


def _watch(daemon: ControlClient, run_id: int, bar: ProgressBar) -> dict[str, Any]:
    prompt = None
    for status in daemon.watch():
        if status["run_id"] != run_id:
            last = status.get("last_run")
            if last is None or last["run_id"] != run_id:
                raise error("NOT_FOUND", f"run {run_id} ended unseen; 'cellward show {run_id}' tells how")
            return {**last, "waiting": status.get("waiting", [])}
        bar.show(job_text(status), status["step"], status["steps"])
        if status["prompt"] != prompt and status["prompt"] is not None:
            say(prompt_text(status["prompt"]))
        prompt = status["prompt"]
    raise error("DAEMON_UNREACHABLE", f"before the end of run {run_id}")


def prompt_text(prompt: Mapping[str, Any]) -> str:
    """What the operator is asked for, and how to answer."""
    skip = f", or to leave it out: cellward skip {prompt['id']}" if prompt.get("skippable") else ""
    return f"{prompt['text']}\n  then, in another terminal: cellward confirm {prompt['id']}{skip}"


def finished(end: Mapping[str, Any], as_json: bool, config: Path | None) -> None:
    """Print how a run ended; leaves with the exit code that this end has.

    The result comes from the run's folder: a status has it without its long tables.
    """
    run = end["run_id"]
    if as_json:
        out_json(end)
    elif end.get("result"):
        from daemon.words.result_text import result_text

        try:
            out(result_text(load(config, run).read_result()))
        except CellError as exc:
            tell(exc)
    more = f"report {run}' has the report" if end.get("result") else f"show {run}' tells how"
    say(f"Run {run} ended: {end['outcome']}. 'cellward {more}.")
    for text in next_commands(end, end.get("waiting", [])):
        say(text)
    if failure := end.get("error"):
        raised = as_error(failure)
        tell(raised)
        raise typer.Exit(exit_code_of(raised))
    if end["outcome"] != "complete" or end.get("verdict") == "fail":
        raise typer.Exit(FAILED)


def as_error(described: Mapping[str, Any]) -> CellError:
    """The error that a journal or status describes."""
    entry = catalogue().get(str(described["name"]))
    if entry is None:
        return error("INTERNAL", str(described["text"]))
    return error(entry.name, str(described["text"]).removeprefix(entry.text).removeprefix(": "))
