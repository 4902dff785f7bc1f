"""``cellward demo``: the whole thing on a twin."""

from pathlib import Path
from typing import Annotated

import typer

from cell.errors import error


def demo(
    job: Annotated[list[str] | None, typer.Option("--job", help="Only this job; may be repeated.")] = None,
    fast: Annotated[
        bool, typer.Option("--fast", help="In one process on a virtual clock, without any protocol.")
    ] = False,
    ideal: Annotated[
        bool, typer.Option("--ideal", help="With --fast: in ideal worlds, kinder than any cell.")
    ] = False,
    output: Annotated[Path, typer.Option("--out", help="Folder for the demo's files.")] = Path("demo-out"),
) -> None:
    """Start a twin and the daemon, run the jobs by a Modbus trigger, show the results beside the truth."""
    from daemon.demo.steps import STEPS, shown_with, steps_of

    if unknown := sorted(name for name in set(job or ()) if shown_with(name) is None):
        raise error("UNKNOWN_JOB", f"the demo has no job '{unknown[0]}'; it has {', '.join(STEPS)}")
    if fast:
        from daemon.demo.fast import run_fast

        raise typer.Exit(run_fast(output.absolute(), steps_of(job or ()), ideal))
    if ideal:
        raise error("ARGUMENT_INVALID", "--ideal needs --fast: the demo on real protocols shows both worlds")
    from daemon.demo.wire import run_wire

    raise typer.Exit(run_wire(output.absolute(), steps_of(job or ())))
