"""``cellward pose save``: the joints of the arm, by a name, into ``[poses]`` of cell.toml."""

import os
import re
import stat
from collections.abc import Sequence
from contextlib import suppress
from typing import Annotated

import typer

from cell.errors import CellError, error
from cell.store.files import write_atomic
from daemon.cli.jobs import connect
from daemon.cli.options import ConfigOption, config_path
from daemon.cli.output import out, say

DIGITS = 6  # of a radian: a micrometre at a metre

pose_app = typer.Typer(help="Poses of cell.toml by name.", no_args_is_help=True)


@pose_app.command()
def save(
    name: Annotated[str, typer.Argument(help="Of the pose, as home.", show_default=False)],
    replace: Annotated[bool, typer.Option("--replace", help="Put it in the place of one there is.")] = False,
    config: ConfigOption = None,
) -> None:
    """Write where the arm stands into [poses] of cell.toml; the rest of the file stays as it is.

    The joints come from the running daemon, which knows the pose from its next start on. Nothing moves.
    """
    if not re.fullmatch(r"[A-Za-z0-9_-]{1,40}", name):
        raise error("ARGUMENT_INVALID", f"'{name}': a pose has up to 40 letters, digits, '_' or '-'")
    path = config_path(config).resolve()
    with connect(path) as daemon:
        found = daemon.call("joints")
    if found["moving"]:
        raise error("NOT_NOW", "the arm moves; save the pose when it stands")
    q = [round(value, DIGITS) for value in found["q"]]
    line = f"{name} = {q}"
    try:
        text = with_pose(path.read_text("utf-8"), name, q, replace)
    except CellError as refusal:
        raise error(refusal.name, f"{path}: {refusal.detail}") from None
    if not os.access(path.parent, os.W_OK):
        raise error("ARGUMENT_INVALID", f"{path.parent} cannot be written; add to [poses] of {path}: {line}")
    before = path.stat()
    write_atomic(path, text)
    path.chmod(stat.S_IMODE(before.st_mode))
    with suppress(PermissionError):
        os.chown(path, before.st_uid, before.st_gid)
    out(line)
    say(f"It is in [poses] of {path}; the daemon knows it from its next start on.")


def with_pose(text: str, name: str, q: Sequence[float], replace: bool) -> str:
    """The TOML ``text`` with the pose ``name`` at joints ``q``; ``ARGUMENT_INVALID`` when it is there already
    and is not to be replaced."""
    import tomlkit
    from tomlkit.items import Table

    document = tomlkit.parse(text)
    poses = document.setdefault("poses", tomlkit.table())
    if not isinstance(poses, Table):
        raise error("ARGUMENT_INVALID", "poses is no table of its own; write it as [poses]")
    if name in poses and not replace:
        raise error(
            "ARGUMENT_INVALID", f"there is a pose '{name}' in [poses] already; --replace overwrites it"
        )
    poses[name] = list(q)
    return tomlkit.dumps(document)
