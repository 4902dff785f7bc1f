"""Which of several tools has no reference of the crossed beams in effect: it cannot be checked."""

from cell.calibrations import laser_reference
from daemon.config import CellConfig
from daemon.predictions import ledger_rows
from daemon.tools import usual_tool

CHECKS = ("laser-check", "laser-update")


def without_reference(config: CellConfig) -> list[str]:
    """A sentence for each tool of a cell with several whose reference is missing, with the command for it.

    A cell whose jobs never measure a tool wants none.
    """
    jobs = [job for job in CHECKS if job in config.job]
    if not config.tool or not jobs or "beams" not in config.robot.roles():
        return []
    there = {row["name"] for row in ledger_rows(config) if row["state"] == "committed"}
    names = [tool for tool in config.tool if laser_reference(tool) not in there]
    usual = usual_tool(config, "laser-reference")
    found = []
    for name in names:
        asked = "" if usual is not None and usual.name == name else f" -p tool={name}"
        found.append(
            f"tool '{name}' has no reference of the crossed beams, so {' and '.join(jobs)} of it are "
            f"refused: cellward start laser-reference{asked}"
        )
    return found
