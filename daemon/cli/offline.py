"""``cellward solve``: from a data set to a result, without robot or daemon."""

from collections.abc import Mapping
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Any

import typer

from cell.errors import error
from cell.formats.result import Envelope, ModelInUse
from daemon.cli.failures import FAILED
from daemon.cli.options import ConfigOption, JsonOption
from daemon.cli.output import out, out_json, say
from daemon.cli.progress import ProgressBar
from procedures.kind import KINDS as ALL_KINDS
from procedures.kind import load

KINDS = {kind.name: kind for kind in sorted(ALL_KINDS.values(), key=lambda k: k.name) if kind.solve}


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
    kinematics: Annotated[
        int | None,
        typer.Option(
            "--kinematics",
            metavar="VERSION",
            help="hand-eye: the cell's arm by this version of its kinematics, before the one in the data.",
        ),
    ] = None,
    report: Annotated[
        Path | None, typer.Option("--report", help="Write an HTML report to this file.")
    ] = None,
    config: ConfigOption = None,
    as_json: JsonOption = False,
) -> None:
    """Solve a data set from anywhere; exit code 1 when the verdict is fail."""
    for written in (output, report):
        if written is not None and not written.absolute().parent.is_dir():
            folder = written.absolute().parent
            raise error("ARGUMENT_INVALID", f"{written}: the folder {folder} does not exist")
    arm: Path | Mapping[str, Any] | None = robot
    model = None
    if kinematics is not None:
        arm, model = _of_version(kinematics, kind, robot, config)
    result = solve_data(kind, path, method, model, predict=predict, targets=targets, robot=arm)
    if output is not None:
        _write(output, result)
    if report is not None:
        from procedures.report.write import write_report

        write_report(result, report, data=path)
        say(f"The report is {report}.")
    if as_json:
        out_json(result)
    else:
        from daemon.words.result_text import result_text

        out(result_text(result))
    if result["verdict"] == "fail":
        raise typer.Exit(FAILED)


def _of_version(
    version: int, kind: str, robot: Path | None, config: Path | None
) -> tuple[dict[str, Any], ModelInUse]:
    if kind != "hand-eye":
        raise error("ARGUMENT_INVALID", f"--kinematics is for hand-eye, not for {kind}; leave it out")
    if robot is not None:
        raise error("ARGUMENT_INVALID", "--robot and --kinematics both tell the arm; give one of them")
    from daemon.cli.kinematics_version import robot_of_version

    return robot_of_version(version, config)


def solve_data(
    kind: str,
    path: Path,
    method: str | None,
    arm_model: ModelInUse | None = None,
    **asked: Path | Mapping[str, Any] | None,
) -> dict[str, Any]:
    """The result document of one data set, with a progress bar on a terminal; it names ``arm_model``.

    ``asked`` are files by option name, an arm also as its ROBOT; a kind that has no use for one that is
    given refuses it.
    """
    if kind not in KINDS:
        near = get_close_matches(kind, KINDS, n=1)
        hint = f"did you mean {near[0]}?" if near else f"there is: {', '.join(KINDS)}"
        raise error("ARGUMENT_INVALID", f"'{kind}' cannot be solved, {hint}")
    files = {option: file for option, file in asked.items() if file is not None}
    if useless := [option for option in files if option not in KINDS[kind].asked]:
        kinds = [k.name for k in KINDS.values() if useless[0] in k.asked]
        raise error(
            "ARGUMENT_INVALID", f"--{useless[0]} is for {', '.join(kinds)}, not for {kind}; leave it out"
        )
    solver = load(KINDS[kind].solve)
    with ProgressBar() as bar:
        found: Envelope = solver(path, method=method, progress=bar.show, **files)
    if arm_model is not None:
        found = found.with_inputs(arm_model=arm_model)
    return found.signed().as_json()


def _write(path: Path, result: dict[str, Any]) -> None:
    from cell.store.files import to_json, write_atomic

    write_atomic(path, to_json(result, indent=1) + "\n")
    say(f"The result is in {path}.")
