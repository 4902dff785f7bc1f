"""``cellward reports``: the index of the reports of this cell."""

from pathlib import Path
from typing import Annotated

import typer

from cell.errors import error
from daemon.cli.options import ConfigOption, cell_paths
from daemon.cli.output import out


def reports(
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", help="The file; reports.html of the state folder.", show_default=False
        ),
    ] = None,
    limit: Annotated[int, typer.Option("--limit", "-n", min=1, help="How many of the newest runs.")] = 500,
    open_it: Annotated[bool, typer.Option("--open/--no-open", help="Show it in a browser.")] = False,
    config: ConfigOption = None,
) -> None:
    """Write one page that lists runs: verdict, main figure, who decided, who signed, and the report.

    Links hold while the file keeps its place beside the folders of the runs.
    """
    from daemon.report_index import CellState, write_report_index
    from procedures.report.index import FILE_NAME

    paths = cell_paths(config)
    target = output or paths.state_dir / FILE_NAME
    if not target.absolute().parent.is_dir():
        raise error("ARGUMENT_INVALID", f"{target}: the folder {target.absolute().parent} does not exist")
    write_report_index([CellState(paths.name, paths.state_dir)], target, limit)
    out(str(target))
    if open_it:
        typer.launch(target.absolute().as_uri())
