"""``cellward import``: data of other programs, as data sets and arm models of this one."""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from cell.errors import error
from daemon.cli.output import out, say

POSES = {
    "csv": "a table of poses",
    "json": "poses in plain JSON",
    "easy-handeye2": "NAME.samples of easy_handeye2",
    "moveit": "samples of MoveIt calibration",
    "visp": "a folder of ViSP with pose_rPe_N.yaml and pose_cPo_N.yaml",
}
UR = "ur"
_LENGTHS, _ANGLES = ("m", "mm"), ("rad", "deg")


def import_data(
    kind: Annotated[str, typer.Argument(help=f"What it is: {', '.join((*POSES, UR))}.", show_default=False)],
    path: Annotated[Path, typer.Argument(help="The file, or the folder.", show_default=False)],
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", help="Write to this file; an existing one is kept. Else it is printed."
        ),
    ] = None,
    setup: Annotated[
        str | None,
        typer.Option("--setup", help="eye-in-hand (camera on the flange) or eye-to-hand (camera at rest)."),
    ] = None,
    length: Annotated[str, typer.Option("--length", help="Unit of lengths in csv and json: m or mm.")] = "m",
    angle: Annotated[
        str, typer.Option("--angle", help="Unit of angles in csv and json: rad or deg.")
    ] = "rad",
    euler: Annotated[
        str | None,
        typer.Option(
            "--euler",
            help="The three angles of csv and json are Euler angles in this order: rpy, fanuc-wpr, kuka-abc, "
            "staubli, kawasaki-oat, or letters: ZYX (axes that turn along) or xyz (axes that stand still).",
        ),
    ] = None,
    model: Annotated[str | None, typer.Option("--model", help="Of a UR arm, as ur10e.")] = None,
) -> None:
    r"""Turn poses of other programs into a data set for 'cellward solve hand-eye'.

    'cellward import ur' turns an .installation, an .urp or the calibration.conf of a UR arm into a ROBOT for
    \[robot] model. docs/importing.md has units, frames and conventions of each kind.
    """
    if kind not in (*POSES, UR):
        raise error("ARGUMENT_INVALID", f"'{kind}' cannot be imported; there is: {', '.join((*POSES, UR))}")
    _refuse_useless(
        kind,
        ("--setup", setup, kind in POSES),
        ("--length", None if length == "m" else length, kind in ("csv", "json")),
        ("--angle", None if angle == "rad" else angle, kind in ("csv", "json")),
        ("--euler", euler, kind in ("csv", "json")),
        ("--model", model, kind == UR),
    )
    if output is not None and output.exists():
        raise error("ARGUMENT_INVALID", f"{output} exists; it is not overwritten")
    if kind == UR:
        from daemon.importing.ur_kinematics import read_ur

        _write(read_ur(path, model), output)
        if output is not None:
            say(
                f'{output} is the arm as its maker measured it. In cell.toml: [robot] model = "{output.name}"'
            )
        return
    found = _pairs(kind, setup, length, angle, euler)(path)
    units = f"{length} and {angle}"
    _write(found.capture(kind, units), output)
    for sentence in found.left_out:
        say(sentence)
    say(f"{len(found.pairs)} poses, {found.setup}, read as {units}.")
    if output is not None:
        say(f"Next: cellward solve hand-eye {output}")


def _pairs(kind: str, setup: str | None, length: str, angle: str, euler: str | None) -> Callable[[Path], Any]:
    from daemon.importing import folders, tables
    from daemon.importing.rotations import ANGLES, LENGTHS, PoseFault, euler_order

    for option, given, units in (("--length", length, _LENGTHS), ("--angle", angle, _ANGLES)):
        if given not in units:
            raise error("ARGUMENT_INVALID", f"{option} {given}: it is {' or '.join(units)}")
    try:
        convention = tables.Convention(
            LENGTHS[length], ANGLES[angle], None if euler is None else euler_order(euler)
        )
    except PoseFault as exc:
        raise error("ARGUMENT_INVALID", f"--euler: {exc}") from exc
    readers: dict[str, Callable[[Path], Any]] = {
        "csv": lambda path: tables.read_csv(path, setup, convention),
        "json": lambda path: tables.read_plain_json(path, setup, convention),
        "easy-handeye2": lambda path: folders.read_easy_handeye2(path, setup),
        "moveit": lambda path: folders.read_moveit(path, setup),
        "visp": lambda path: folders.read_visp(path, setup),
    }
    return readers[kind]


def _refuse_useless(kind: str, *options: tuple[str, str | None, bool]) -> None:
    for option, given, useful in options:
        if given is not None and not useful:
            raise error("ARGUMENT_INVALID", f"{option} says nothing about '{kind}'; leave it out")


def _write(document: dict[str, Any], output: Path | None) -> None:
    from cell.store.files import to_json, write_atomic

    text = to_json(document, indent=1)
    if output is None:
        out(text)
        return
    if not output.absolute().parent.is_dir():
        raise error("ARGUMENT_INVALID", f"{output}: the folder {output.absolute().parent} does not exist")
    write_atomic(output, text + "\n")
