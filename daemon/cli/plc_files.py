"""``cellward plc-files``: what a PLC's project takes in."""

from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import typer

from cell.errors import error
from daemon.cli.output import out


def plc_files(
    folder: Annotated[
        Path, typer.Argument(help="Where to write them; made when missing.", show_default=False)
    ],
    force: Annotated[bool, typer.Option("--force", help="Write over files of these names.")] = False,
) -> None:
    """Write the register table and function blocks for a PLC's project, and URScript for a robot program."""
    from daemon.modbus import register_table
    from daemon.modbus.plc_files import plcopen_xml, register_csv, robot_script, structured_text

    created = datetime.now(UTC).replace(microsecond=0, tzinfo=None).isoformat()
    texts = {
        "registers.csv": register_csv(register_table()),
        "cellward.xml": plcopen_xml(register_table(), created),
        "cellward.st": structured_text(),
        "cellward.script": robot_script(),
    }
    there = [name for name in texts if (folder / name).exists()]
    if there and not force:
        raise error("ARGUMENT_INVALID", f"{folder} has {', '.join(there)}; give --force to write over them")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, text in texts.items():
            (folder / name).write_text(text, "utf-8", newline="")
            out(str(folder / name))
    except OSError as exc:
        raise error("ARGUMENT_INVALID", f"{folder} cannot be written: {exc.strerror or exc}") from exc
