"""``cellward init``: a first cell.toml, from questions, from options, or the whole commented example."""

import sys
import tomllib
from pathlib import Path
from typing import Annotated, Any

import typer

from cell.errors import error
from daemon.cli.output import out, say

DEFAULT_NAME, DEFAULT_MODEL, DEFAULT_ARM = "cell", "ur10e", "192.168.10.20"

TO_EDIT = (
    "Edit the addresses, payload and tool, the [limits] with the workspace, the nominal poses, and the "
    "printed size of the board; poses are taught with 'cellward pose save'."
)


def init(
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Write to this file; an existing one is kept.")
    ] = None,
    example: Annotated[bool, typer.Option("--example", help="Whatever can be set, commented.")] = False,
    name: Annotated[str | None, typer.Option("--name", help="Of the cell, as reports show it.")] = None,
    arm: Annotated[str | None, typer.Option("--arm", help="Address of the arm's controller.")] = None,
    model: Annotated[str | None, typer.Option("--model", help="Of the arm, as ur10e.")] = None,
    camera: Annotated[bool, typer.Option("--camera", help="A depth camera sits on the flange.")] = False,
    beams: Annotated[
        str | None, typer.Option("--beams", help="Inputs of two crossed light beams, as tcp://HOST:502.")
    ] = None,
    tracker: Annotated[
        str | None,
        typer.Option(
            "--tracker", help="A laser tracker or total station, as serial:///dev/ttyUSB1 or tcp://HOST:PORT."
        ),
    ] = None,
    belt: Annotated[
        str | None, typer.Option("--belt", help="CAN bus of a conveyor's encoder, as socketcan:can0.")
    ] = None,
    plc: Annotated[str | None, typer.Option("--plc", help="Address of a PLC that may command.")] = None,
    page: Annotated[bool, typer.Option("--page", help="Serve the operator's page on this computer.")] = False,
) -> None:
    """Write a cell.toml with what the cell has.

    Options tell; without any it asks on a terminal, and prints the whole example elsewhere.
    """
    from daemon.config import init_text

    told = {
        "name": name, "arm": arm, "model": model, "camera": camera or None, "beams": beams,
        "tracker": tracker, "belt": belt, "plc": plc, "page": page or None,
    }  # fmt: skip
    given = {key: value for key, value in told.items() if value is not None}
    if example and given:
        raise error("ARGUMENT_INVALID", f"--example writes everything; leave --{next(iter(given))} out")
    if output is not None and output.exists():
        raise error("ARGUMENT_INVALID", f"{output} exists; it is not overwritten")
    if not example and not given and sys.stdin.isatty() and sys.stderr.isatty():
        given = _asked()
    text = _drafted(given) if given else init_text()
    if output is None:
        out(text.rstrip())
        return
    try:
        with output.open("x", encoding="utf-8") as file:
            file.write(text)
    except OSError as exc:
        raise error("ARGUMENT_INVALID", f"{output} cannot be written: {exc.strerror or exc}") from exc
    say(f"{output} is written. {TO_EDIT} Then: cellward check --config {output}")


def _drafted(given: dict[str, Any]) -> str:
    from calibration.kinematics.ur_models import UR_MODELS
    from daemon.config.draft import Cell, draft
    from daemon.config.drivers import DRIVERS
    from daemon.config.findings import ConfigInvalid, Findings
    from daemon.config.load import check_config
    from procedures.registry import JOBS

    cell = Cell(**{"name": DEFAULT_NAME, "model": DEFAULT_MODEL, "arm": DEFAULT_ARM, **given})
    if cell.model not in UR_MODELS:
        raise error("ARGUMENT_INVALID", f"--model {cell.model}: there is {', '.join(UR_MODELS)}")
    text = draft(cell)
    try:
        check_config(tomllib.loads(text), Findings("draft"), JOBS, DRIVERS, Path("cell.toml"))
    except ConfigInvalid as exc:
        why = "; ".join(finding.partition(": ")[2] for finding in exc.findings)
        raise error("ARGUMENT_INVALID", f"nothing is written: {why}") from None
    return text


def _asked() -> dict[str, Any]:
    """The answers of a person; an empty one takes what stands in brackets, or says that there is none."""
    say("What the cell has; an empty answer takes what stands in brackets. Ctrl-C ends, nothing is written.")
    given: dict[str, Any] = {
        "name": typer.prompt("Name of the cell", DEFAULT_NAME, err=True),
        "model": typer.prompt("Model of the arm", DEFAULT_MODEL, err=True),
        "arm": typer.prompt("Address of the arm's controller", DEFAULT_ARM, err=True),
        "camera": typer.confirm("Is there a depth camera on the flange?", default=True, err=True),
    }
    for key, text in (
        ("beams", "Inputs of two crossed light beams, as tcp://192.168.10.30:502 (empty: none)"),
        ("tracker", "Laser tracker or total station, as tcp://HOST:PORT (empty: none)"),
        ("belt", "CAN bus of a conveyor's encoder, as socketcan:can0 (empty: none)"),
        ("plc", "Address of a PLC that may give commands (empty: none)"),
    ):
        given[key] = typer.prompt(text, "", err=True, show_default=False).strip() or None
    given["page"] = typer.confirm("Serve the operator's page on this computer?", default=True, err=True)
    return given
