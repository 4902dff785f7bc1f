"""Commands that talk to the running daemon: what it does, and what it shall do."""

from pathlib import Path
from typing import Annotated, Any

import typer

from cell.errors import error
from daemon.cli.options import ConfigOption, JsonOption, WaitOption, cell_paths, know_configured_jobs
from daemon.cli.output import out, out_json, say
from daemon.control_client import ControlClient

DRY_RUN_TIMEOUT_S = 300.0  # a plan waits for the board and computes for a while
START_TIMEOUT_S = 30.0


def connect(config: Path | None) -> ControlClient:
    """The daemon of this cell, or ``DAEMON_UNREACHABLE``."""
    return ControlClient(cell_paths(config).control_socket)


def status(config: ConfigOption = None, as_json: JsonOption = False) -> None:
    """State, job, devices and the last result."""
    from daemon.cli.status_text import status_text

    with connect(config) as daemon:
        now = daemon.call("status")
    if as_json:
        out_json(now)
    else:
        out(status_text(now))


def watch(config: ConfigOption = None, as_json: JsonOption = False) -> None:
    """The status live, a line a change, until Ctrl-C; with --json one object a line.

    Scripts that follow the cell use 'watch --json': each call of 'status' starts an interpreter.
    """
    import json
    import sys

    from daemon.cli.status_text import change_line, without_state

    last, told = None, set[str]()
    with connect(config) as daemon:
        for now in daemon.watch():
            line = json.dumps(now) if as_json else change_line(now)
            if (step := line if as_json else without_state(now)) != last:
                last, told = step, set()
            if line not in told:  # a job that goes to and fro within a step is told once a step
                out(line)
                sys.stdout.flush()
            told.add(line)


def start(
    job: Annotated[
        str, typer.Argument(help="The job, for instance cone-capture, or a recipe.", show_default=False)
    ],
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="List the plan with every check; nothing moves.")
    ] = False,
    parameter: Annotated[
        list[str] | None,
        typer.Option("--parameter", "-p", help="KEY_UNIT=VALUE, for this run only; may be repeated."),
    ] = None,
    wait: WaitOption = False,
    config: ConfigOption = None,
    as_json: JsonOption = False,
) -> None:
    """Start a job; prints the number of its run."""
    parameters = dict(_pair(text) for text in parameter or [])
    if dry_run:
        from daemon.words.plan_text import plan_text

        with connect(config) as daemon:
            know_configured_jobs(config)
            made = daemon.call("start", DRY_RUN_TIMEOUT_S, job=job, params=parameters, dry_run=True)
        out_json(made["plan"]) if as_json else out(plan_text(made["plan"]))
        if (number := made.get("run_id")) is not None:
            say(f"The dry run is kept as run {number}; nothing moved.")
        return
    _start(config, wait, as_json, {"job": job, "params": parameters})


def adopt(
    run: Annotated[int, typer.Argument(help="The interrupted run.", show_default=False)],
    wait: WaitOption = False,
    config: ConfigOption = None,
    as_json: JsonOption = False,
) -> None:
    """Start a job again with the finished poses of an interrupted run."""
    from cell.store.runs import load_run

    old = load_run(cell_paths(config).runs, run)
    asked = {"job": old.info.get("recipe") or old.job, "params": old.info.get("parameters") or {}}
    _start(config, wait, as_json, {**asked, "adopt": run})


def _start(config: Path | None, wait: bool, as_json: bool, request: dict[str, Any]) -> None:
    with connect(config) as daemon:
        started = daemon.call("start", START_TIMEOUT_S, **request)
    run_id = started["run_id"]
    if not wait:
        out_json(started) if as_json else out(str(run_id))
        say(f"{request['job']} runs as run {run_id}. 'cellward watch' shows it, 'cellward abort' stops it.")
        return
    from daemon.cli.follow import finished, follow

    with connect(config) as daemon:
        end = follow(daemon, run_id)
    finished(end, as_json, config)


def _pair(text: str) -> tuple[str, str]:
    key, equals, value = text.partition("=")
    if not (key and equals):
        raise error(
            "ARGUMENT_INVALID", f"-p {text}: a parameter is given as KEY_UNIT=VALUE, like settle_s=0.5"
        )
    return key.strip(), value.strip()


def confirm(
    prompt: Annotated[int, typer.Argument(help="The number that the prompt shows.", show_default=False)],
    config: ConfigOption = None,
) -> None:
    """Confirm that what a prompt asks for is done; the job goes on and the arm may move."""
    _tell(config, "confirm", f"Prompt {prompt} is confirmed; the job goes on.", prompt_id=prompt)


def skip(
    prompt: Annotated[int, typer.Argument(help="The number that the prompt shows.", show_default=False)],
    config: ConfigOption = None,
) -> None:
    """Leave out what a prompt asks for, such as one placement; the job goes on and the arm may move."""
    _tell(config, "skip", f"What prompt {prompt} asks for is left out; the job goes on.", prompt_id=prompt)


def finish(config: ConfigOption = None) -> None:
    """End the job at its next checkpoint and solve with the data so far."""
    _tell(config, "finish", "The job ends at its next checkpoint and keeps its data.")


def abort(config: ConfigOption = None) -> None:
    """Stop the arm and end the job."""
    _tell(config, "abort", "The job is being stopped; 'cellward status' shows when the arm is at rest.")


def halt(config: ConfigOption = None) -> None:
    """Stop the arm and do nothing else."""
    _tell(
        config,
        "halt",
        "The arm is being stopped. This is no safety function: use the emergency stop to protect people.",
    )


def pause(config: ConfigOption = None) -> None:
    """Hold the job at its next checkpoint with the arm at rest."""
    _tell(config, "pause", "The job holds at its next checkpoint; 'cellward resume' goes on.")


def resume(config: ConfigOption = None) -> None:
    """Go on after a pause; the arm may move."""
    _tell(config, "resume", "The job goes on.")


def reset(config: ConfigOption = None) -> None:
    """Leave a fault after its cause is cleared; nothing moves."""
    with connect(config) as daemon:
        before = daemon.call("status")
        daemon.call("reset")
    if before.get("error") or before.get("latched"):
        say("The fault is reset; jobs can be started.")
    else:
        say("There was no fault to reset; jobs can be started.")


def _tell(config: Path | None, method: str, done: str, **params: Any) -> None:
    with connect(config) as daemon:
        daemon.call(method, **params)
    say(done)
