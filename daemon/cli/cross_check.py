"""``cellward cross-check``: which part of the cell has changed since a capture."""

from pathlib import Path
from typing import Annotated

import typer

from daemon.cli.failures import FAILED
from daemon.cli.history import load
from daemon.cli.options import ConfigOption, JsonOption
from daemon.cli.output import out, out_json, say


def cross_check(
    then: Annotated[int, typer.Argument(help="Run of the capture when all was well.", show_default=False)],
    now: Annotated[int, typer.Argument(help="Run of the capture of now.", show_default=False)],
    beams: Annotated[
        int | None, typer.Option("--beams", help="Run of laser-check or laser-update of now.")
    ] = None,
    tracker: Annotated[int | None, typer.Option("--tracker", help="Run of tracker-sampling of now.")] = None,
    touch: Annotated[int | None, typer.Option("--touch", help="Run of touch-test of now.")] = None,
    report: Annotated[
        Path | None, typer.Option("--report", help="Write an HTML report to this file.")
    ] = None,
    config: ConfigOption = None,
    as_json: JsonOption = False,
) -> None:
    """Tool, camera or a joint's zero: what has changed, or that it cannot be told; exit code 1 for a part."""
    from daemon.words.result_text import result_text
    from procedures.cross_check.solver import check_cell

    first, second = (load(config, number).path for number in (then, now))
    others = (None if run is None else load(config, run).path for run in (beams, tracker, touch))
    result = check_cell(first, second, *others).signed().as_json()
    if report is not None:
        from procedures.report.write import write_report

        write_report(result, report)
        say(f"The report is {report}.")
    if as_json:
        out_json(result)
    else:
        out(result_text(result))
    if result["verdict"] == "fail":
        raise typer.Exit(FAILED)
