"""``cellward solve``: from a data set to a result, without robot or daemon."""

from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Any

import typer

from cell.errors import error
from daemon.cli.failures import FAILED
from daemon.cli.options import JsonOption
from daemon.cli.output import out, out_json, say
from daemon.cli.progress import ProgressBar

KINDS = ("hand-eye",)


def solve(
    kind: Annotated[str, typer.Argument(help=f"What to solve: {', '.join(KINDS)}.", show_default=False)],
    path: Annotated[
        Path,
        typer.Argument(help="The data set: a folder with capture.json, or the file.", show_default=False),
    ],
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Write the result as JSON to this file.")
    ] = None,
    method: Annotated[
        str | None, typer.Option("--method", help="Another method than the weighted maximum likelihood.")
    ] = None,
    report: Annotated[
        Path | None, typer.Option("--report", help="Write an HTML report to this file.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Solve a data set from anywhere; exit code 1 when the verdict is fail."""
    for target in (output, report):
        if target is not None and not target.absolute().parent.is_dir():
            raise error("ARGUMENT_INVALID", f"{target}: the folder {target.absolute().parent} does not exist")
    result = solve_data(kind, path, method)
    if output is not None:
        _write(output, result)
    if report is not None:
        from procedures.report import write_report

        write_report(result, report, data=path)
        say(f"The report is {report}.")
    if as_json:
        out_json(result)
    else:
        from daemon.cli.result_text import result_text

        out(result_text(result))
    if result["verdict"] == "fail":
        raise typer.Exit(FAILED)


def solve_data(kind: str, path: Path, method: str | None) -> dict[str, Any]:
    """The result document of one data set, with a progress bar on a terminal."""
    if kind not in KINDS:
        near = get_close_matches(kind, KINDS, n=1)
        hint = f"did you mean {near[0]}?" if near else f"there is: {', '.join(KINDS)}"
        raise error("ARGUMENT_INVALID", f"'{kind}' cannot be solved, {hint}")
    from procedures.solve.hand_eye import solve_hand_eye

    with ProgressBar() as bar:
        return solve_hand_eye(path, method=method, progress=bar.show)


def _write(path: Path, result: dict[str, Any]) -> None:
    from cell.store.files import to_json, write_atomic

    write_atomic(path, to_json(result, indent=1) + "\n")
    say(f"The result is in {path}.")
