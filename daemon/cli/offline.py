"""``cellward solve``: from a data set to a result, without robot or daemon."""

from difflib import get_close_matches
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import typer

from cell.errors import error
from daemon.cli.failures import FAILED
from daemon.cli.options import JsonOption
from daemon.cli.output import out, out_json, say
from daemon.cli.progress import ProgressBar

# Where the solver of each kind of data set is: called with the path, ``method`` and ``progress``.
SOLVERS = {
    "hand-eye": "procedures.solve.hand_eye:solve_hand_eye",
    "intercept": "procedures.solve.intercept:solve_intercept",
    "kincal": "procedures.solve.kincal:solve_kincal",
    "laser": "procedures.solve.laser:solve_laser",
}
KINDS = tuple(SOLVERS)
# What else a kind can be asked: option names that its solver takes as further arguments.
ASKED: dict[str, tuple[str, ...]] = {"kincal": ("predict", "targets", "robot")}


def solve(
    kind: Annotated[str, typer.Argument(help=f"What to solve: {', '.join(KINDS)}.", show_default=False)],
    path: Annotated[
        Path,
        typer.Argument(help="The data set: the folder that holds it, or the file.", show_default=False),
    ],
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Write the result as JSON to this file.")
    ] = None,
    method: Annotated[
        str | None, typer.Option("--method", help="Another method than the best one, for comparison.")
    ] = None,
    predict: Annotated[
        Path | None, typer.Option("--predict", help="Joints for which the answer is to be predicted.")
    ] = None,
    targets: Annotated[
        Path | None, typer.Option("--targets", help="Wanted poses that are to be corrected.")
    ] = None,
    robot: Annotated[
        Path | None, typer.Option("--robot", help="A file with the ROBOT, before the one in the data.")
    ] = None,
    report: Annotated[
        Path | None, typer.Option("--report", help="Write an HTML report to this file.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Solve a data set from anywhere; exit code 1 when the verdict is fail."""
    for written in (output, report):
        if written is not None and not written.absolute().parent.is_dir():
            folder = written.absolute().parent
            raise error("ARGUMENT_INVALID", f"{written}: the folder {folder} does not exist")
    result = solve_data(kind, path, method, predict=predict, targets=targets, robot=robot)
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


def solve_data(kind: str, path: Path, method: str | None, **asked: Path | None) -> dict[str, Any]:
    """The result document of one data set, with a progress bar on a terminal.

    ``asked`` are files by option name; a kind that has no use for one that is given refuses it.
    """
    if kind not in KINDS:
        near = get_close_matches(kind, KINDS, n=1)
        hint = f"did you mean {near[0]}?" if near else f"there is: {', '.join(KINDS)}"
        raise error("ARGUMENT_INVALID", f"'{kind}' cannot be solved, {hint}")
    files = {option: file for option, file in asked.items() if file is not None}
    if useless := [option for option in files if option not in ASKED.get(kind, ())]:
        kinds = [k for k, options in ASKED.items() if useless[0] in options]
        raise error(
            "ARGUMENT_INVALID", f"--{useless[0]} is for {', '.join(kinds)}, not for {kind}; leave it out"
        )
    module, name = SOLVERS[kind].split(":")
    solver = getattr(import_module(module), name)
    with ProgressBar() as bar:
        result: dict[str, Any] = solver(path, method=method, progress=bar.show, **files)
    return result


def _write(path: Path, result: dict[str, Any]) -> None:
    from cell.store.files import to_json, write_atomic

    write_atomic(path, to_json(result, indent=1) + "\n")
    say(f"The result is in {path}.")
