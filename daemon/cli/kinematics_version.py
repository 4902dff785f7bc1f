"""An arm's kinematics out of the ledger by their version, also one that is no longer in effect."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from cell.calibrations import kinematics
from cell.errors import error
from cell.formats.result import ModelInUse
from daemon.cli.options import cell_paths

_MOST = 100_000  # results of one name


def robot_of_version(version: int, config: Path | None) -> tuple[dict[str, Any], ModelInUse]:
    """The ROBOT of a version of the arm's kinematics, and its name and version; ``NOT_FOUND`` names the
    versions that there are."""
    from cell.store.ledger import Ledger
    from daemon.config import load_config

    paths = cell_paths(config)
    arm = load_config(paths.config).robot.roles().get("arm")
    if arm is None:
        raise error("ARGUMENT_INVALID", f"--kinematics is of the arm of a cell, and {paths.config} has none")
    name, rows = kinematics(arm), []
    if paths.ledger.exists():
        ledger = Ledger(paths.ledger, read_only=True)
        try:
            rows = [row for row in ledger.results(name, _MOST) if row["version"] is not None]
        finally:
            ledger.close()
    value = next((row["value"] for row in rows if row["version"] == version), None)
    if value is None:
        there = ", ".join(str(row["version"]) for row in reversed(rows)) or "none was accepted yet"
        raise error("NOT_FOUND", f"version {version} of {name}; there is {there}")
    robot = value.get("robot") if isinstance(value, Mapping) else None
    if not isinstance(robot, Mapping):
        raise error("DATA_INVALID", f"version {version} of {name} holds no ROBOT")
    return dict(robot), ModelInUse(name=name, version=version)
