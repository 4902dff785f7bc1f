"""``cellward pose save``: the joints of the arm, by a name, into ``[poses]`` of cell.toml."""

import os
import re
import stat
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cell.errors import CellError, error
from cell.store.files import disk_errors, sync_folder
from daemon.cli.jobs import connect
from daemon.cli.options import ConfigOption, config_path
from daemon.cli.output import out, say

if TYPE_CHECKING:
    from tomlkit.items import Comment, Table, Whitespace

DIGITS = 6  # of a radian: a micrometre at a metre

pose_app = typer.Typer(help="Poses of cell.toml by name.", no_args_is_help=True)


@pose_app.command()
def save(
    name: Annotated[str, typer.Argument(help="Of the pose, as home.", show_default=False)],
    replace: Annotated[bool, typer.Option("--replace", help="Put it in the place of one there is.")] = False,
    config: ConfigOption = None,
) -> None:
    r"""Write where the arm stands into \[poses] of cell.toml; the rest of the file stays as it is.

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
    _require_writable(path, line)
    try:
        text = with_pose(path.read_bytes().decode("utf-8"), name, q, replace)
    except CellError as refusal:
        raise error(refusal.name, f"{path}: {refusal.detail}") from None
    before = path.stat()
    draft = path.with_name(f".{path.name}.pose.tmp")
    try:
        with disk_errors(draft), draft.open("wb") as file:
            draft.chmod(0o600)  # what cell.toml holds may not be for everybody
            file.write(text.encode("utf-8"))
            file.flush()
            os.fsync(file.fileno())
        _require_loads(draft, path)
        draft.chmod(stat.S_IMODE(before.st_mode))
        os.chown(draft, before.st_uid, before.st_gid)
        draft.replace(path)
        sync_folder(path.parent)
    finally:
        draft.unlink(missing_ok=True)
    out(line)
    say(f"It is in [poses] of {path}; the daemon knows it from its next start on.")


def _require_writable(path: Path, line: str) -> None:
    """The file is replaced as a whole, and stays whose it is."""
    writable = os.access(path, os.W_OK) and os.access(path.parent, os.W_OK)
    if not writable or os.geteuid() not in (0, path.stat().st_uid):
        raise error(
            "NOT_ALLOWED",
            f"{path} belongs to somebody else; run it as its owner (sudo), or add to its [poses]: {line}",
        )


def _require_loads(draft: Path, path: Path) -> None:
    """The daemon will start with it as well as before: a joint beyond its range is no pose."""
    from daemon.config import load_config

    try:
        load_config(draft)
    except CellError as refusal:
        text = str(refusal).replace(str(draft), str(path))
        raise error("ARGUMENT_INVALID", f"{path} is left as it was; with this pose: {text}") from None


def with_pose(text: str, name: str, q: Sequence[float], replace: bool) -> str:
    """The TOML ``text`` with the pose ``name`` at joints ``q``; ``ARGUMENT_INVALID`` when it is there already
    and is not to be replaced."""
    import tomlkit
    from tomlkit.items import Table

    of_windows = 0 < text.count("\n") == text.count("\r\n")
    document = tomlkit.parse(text.replace("\r\n", "\n") if of_windows else text)
    poses = document.setdefault("poses", tomlkit.table())
    if not isinstance(poses, Table):
        raise error("ARGUMENT_INVALID", "poses is no table of its own; write it as [poses]")
    if name in poses and not replace:
        raise error("ARGUMENT_INVALID", f"[poses] has a pose '{name}' already; --replace overwrites it")
    # A new key would come below the comment that heads the next section: that is set aside meanwhile.
    rest = _behind_the_last_key(poses) if name not in poses else []
    poses[name] = list(q)
    for item in rest:
        poses.add(item)
    changed = tomlkit.dumps(document)
    return changed.replace("\n", "\r\n") if of_windows else changed


def _behind_the_last_key(table: "Table") -> list["Comment | Whitespace"]:
    """Take the blank lines and comments off the end of a table."""
    from tomlkit.items import Comment, Whitespace

    body, taken = table.value.body, list[Comment | Whitespace]()
    while body and isinstance(last := body[-1][1], Comment | Whitespace):
        taken.insert(0, last)
        body.pop()
    return taken
