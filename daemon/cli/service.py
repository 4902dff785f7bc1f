"""``cellward install`` and ``cellward uninstall``: this host as the host of a cell."""

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cell.errors import CellError, error
from daemon.cli.output import out, say

if TYPE_CHECKING:
    from daemon.config import CellConfig

RootOption = Annotated[
    Path, typer.Option("--root", help="Install below this folder instead of the running system.")
]


def install(
    context: typer.Context,
    root: RootOption = Path("/"),
    wheelhouse: Annotated[
        Path | None,
        typer.Option(
            "--wheelhouse", help="Folder of wheels; needs no network. Without it the program stays."
        ),
    ] = None,
    python: Annotated[
        Path | None,
        typer.Option("--python", help="Interpreter there; else /usr/bin/pythonX.Y as here."),
    ] = None,
    allow: Annotated[
        list[str] | None,
        typer.Option("--allow", help="Another network that the service may reach, as 10.0.5.0/24."),
    ] = None,
) -> None:
    """Install the service: program, user, unit, udev rules, and the networks of /etc/cellward/cell.toml.

    Run it again after an upgrade or a change of addresses: it brings all of it up to date and starts nothing.
    """
    from daemon.cli.manual import man_page
    from daemon.service import install as service
    from daemon.service.program import default_python

    _need_root(root)
    config = _config(root)
    done = service.install(
        root.absolute(),
        None if wheelhouse is None else wheelhouse.absolute(),
        python or default_python(),
        man_page(context.find_root().command) + "\n",
        config,
        allow or [],
    )
    _tell(done.did, done.left)


def uninstall(root: RootOption = Path("/")) -> None:
    """Remove program, unit and rules. The configuration, runs and results stay where they are."""
    from daemon.service import install as service

    _need_root(root)
    done = service.uninstall(root.absolute())
    _tell(done.did, done.left)


def _tell(did: list[str], left: list[str]) -> None:
    for sentence in did:
        out(sentence[:1].upper() + sentence[1:] + ".")
    for sentence in left:
        say(sentence)


def _need_root(root: Path) -> None:
    if not root.is_dir():
        raise error("ARGUMENT_INVALID", f"--root {root} is no folder")
    if root.resolve() == Path("/") and os.geteuid() != 0:
        raise error("NOT_ALLOWED", "only root installs a service: sudo cellward install")


def _config(root: Path) -> "CellConfig | None":
    """The checked configuration below ``root``; None where there is none yet."""
    from daemon.config import load_config
    from daemon.service.places import CONFIG

    path = root / CONFIG
    if not path.exists():
        return None
    try:
        return load_config(path)
    except CellError:
        say("The configuration is not right yet; nothing was installed.")
        raise
