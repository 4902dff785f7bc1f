"""Options that many commands share, and the two paths that they need from cell.toml."""

import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from cell.errors import error
from daemon.cli.output import say

DEFAULT_CONFIG = Path("/etc/cellward/cell.toml")

ConfigOption = Annotated[
    Path | None,
    typer.Option(
        "--config",
        "-c",
        envvar="CELLWARD_CONFIG",
        help=f"The cell's configuration; {DEFAULT_CONFIG} unless given.",
        show_default=False,
    ),
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON (SI units) for programs.")]
WaitOption = Annotated[
    bool, typer.Option("--wait", "--follow", help="Stay until the job ends; show its progress and result.")
]


@dataclass(frozen=True)
class CellPaths:
    """What a cell is called, where it keeps its runs, and where its daemon listens."""

    config: Path
    state_dir: Path
    control_socket: Path
    name: str = "cell"

    @property
    def runs(self) -> Path:
        return self.state_dir / "runs"

    @property
    def ledger(self) -> Path:
        return self.state_dir / "ledger.sqlite"


def config_path(option: Path | None) -> Path:
    """The configuration file that is meant; ``FILE_MISSING`` says how to name or make one."""
    path = option or DEFAULT_CONFIG
    if not path.is_file():
        raise error(
            "FILE_MISSING",
            f"there is no configuration {path}; name one with --config or CELLWARD_CONFIG, or write one "
            "with 'cellward init'",
        )
    return path


def cell_paths(option: Path | None) -> CellPaths:
    """The paths in ``[cell]``.

    They are read without checking the rest of the file: ``status`` must be quick, and must work while
    somebody edits the file of a running daemon. What ``[cell]`` leaves out comes from the full check.
    """
    path = config_path(option)
    section = _section(path, "cell")
    state, control = section.get("state_dir"), section.get("control_socket")
    if not all(isinstance(p, str) and p.startswith("/") for p in (state, control)):
        from daemon.config import load_config

        full = load_config(path).cell
        state, control = full.state_dir, full.control_socket
    name = section.get("name")
    paths = CellPaths(path, Path(str(state)), Path(str(control)), name if isinstance(name, str) else "cell")
    if paths.state_dir.exists() and not paths.state_dir.is_dir():
        raise error("FILE_UNREADABLE", f"{paths.state_dir}, [cell] state_dir of {path}, is not a folder")
    return paths


def know_configured_jobs(option: Path | None) -> None:
    """Make the jobs that ``[job.NAME] procedure`` names known here, so that their runs are read.

    The rest of the file is not checked. One that cannot be loaded is said: runs of others are read anyway.
    """
    path = config_path(option)
    sections = _section(path, "job").items()
    named = {
        name: keys["procedure"] for name, keys in sections if isinstance(keys, dict) and "procedure" in keys
    }
    if not named:
        return
    from procedures.registry import SHIPPED, add_configured

    for name, reference in named.items():
        try:
            if name not in SHIPPED:
                add_configured(name, str(reference))
        except LookupError as exc:
            say(f"{path}: job.{name}.procedure: {exc.args[0]}")


def _section(path: Path, name: str) -> dict[str, Any]:
    try:
        section = tomllib.loads(path.read_text("utf-8")).get(name, {})
    except OSError as exc:
        raise error("FILE_UNREADABLE", f"{path}: {exc.strerror or exc}") from exc
    except ValueError as exc:  # not TOML, or not UTF-8
        raise error("CONFIG_INVALID", f"{path} is not TOML: {exc}") from exc
    return section if isinstance(section, dict) else {}
