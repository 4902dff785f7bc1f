"""The program below ``/opt/cellward``: one venv a version, of wheels alone, and a link to the one in use."""

import os
import re
import shutil
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

from cell.errors import error
from daemon.service.places import PROGRAMS

CURRENT = "current"
_WHEEL = re.compile(r"cellward-(?P<version>[^-]+)-py3-none-any\.whl")
_SCRIPT_BYTES = 1_000_000


def installed(root: Path) -> str | None:
    """The version that the link ``current`` points to."""
    link = root / PROGRAMS / CURRENT
    return os.readlink(link) if link.is_symlink() else None


def wheel_version(wheelhouse: Path) -> str:
    """The version of the one cellward wheel in ``wheelhouse``; ``ARGUMENT_INVALID`` when there is not one."""
    versions = [
        match["version"] for path in wheelhouse.glob("*.whl") if (match := _WHEEL.fullmatch(path.name))
    ]
    if len(versions) != 1:
        raise error(
            "ARGUMENT_INVALID",
            f"{wheelhouse} holds {len(versions)} wheels of cellward; 'make wheelhouse' makes one",
        )
    return versions[0]


def refuse_older(version: str, present: str | None) -> None:
    """``INSTALL_REFUSED`` when ``version`` is older than the one in use, which may have changed the store."""
    if present is not None and _ordered(version) < _ordered(present):
        raise error(
            "INSTALL_REFUSED",
            f"cellward {present} is installed and {version} is older: it may not read the store, whose form "
            f"{present} may have changed. To go back all the same: 'cellward uninstall', put the copy "
            "ledger.sqlite.schema-N of the time before in place of ledger.sqlite, and install again",
        )


def make_program(root: Path, wheelhouse: Path, version: str, python: Path, packaged: bool) -> None:
    """A venv with ``version`` from the wheels, below ``root`` as if it were ``/``, and the link to it.

    The version before is kept, older ones go: a daemon that runs uses its own files until its restart.
    """
    programs = root / PROGRAMS
    programs.mkdir(parents=True, exist_ok=True)
    draft, final = programs / f".new-{version}", programs / version
    shutil.rmtree(draft, ignore_errors=True)
    try:
        # With a pip of its own: the program that runs may be in a venv without one.
        _run([sys.executable, "-m", "venv", "--symlinks", str(draft)], "venv (apt install python3-venv)")
        pip = [str(draft / "bin/python"), "-m", "pip", "--isolated", "--disable-pip-version-check", "install"]
        wheels_alone = ["--no-index", "--only-binary", ":all:", "--find-links", str(wheelhouse)]
        _run([*pip, "--quiet", "--no-compile", *wheels_alone, f"cellward[mqtt,mcap]=={version}"], "pip")
        _relocate(draft, f"/{PROGRAMS / version}", python)
        _compile(draft, f"/{PROGRAMS / version}")
    except BaseException:
        shutil.rmtree(draft, ignore_errors=True)
        raise
    shutil.rmtree(final, ignore_errors=True)
    draft.rename(final)
    present = installed(root)
    link = programs / f".{CURRENT}"
    link.unlink(missing_ok=True)
    link.symlink_to(version)
    link.replace(programs / CURRENT)
    kept = {version} if packaged else {version, present}
    for folder in programs.iterdir():
        if folder.name != CURRENT and folder.name not in kept:
            shutil.rmtree(folder, ignore_errors=True)


def remove_programs(root: Path) -> None:
    """Every version and the link."""
    shutil.rmtree(root / PROGRAMS, ignore_errors=True)


def _relocate(venv: Path, final: str, python: Path) -> None:
    """Let the venv say ``final`` and ``python`` where it says the place and the interpreter of its making."""
    made_at = str(venv).encode()
    for path in (*venv.joinpath("bin").iterdir(), venv / "pyvenv.cfg"):
        if path.is_symlink() or not path.is_file() or path.stat().st_size > _SCRIPT_BYTES:
            continue
        data = path.read_bytes()
        if made_at in data:
            path.write_bytes(data.replace(made_at, final.encode()))
    for name in ("python", "python3", f"python{_minor()}"):
        with suppress(FileNotFoundError):
            (venv / "bin" / name).unlink()
        (venv / "bin" / name).symlink_to(python if name == "python" else "python")
    (venv / "pyvenv.cfg").write_text(
        f"home = {python.parent}\ninclude-system-site-packages = false\nversion = {_minor()}\n"
        f"executable = {python}\ncommand = {python} -m venv {final}\n"
    )


def _compile(venv: Path, final: str) -> None:
    """Byte code under the names of the final place: the daemon's user may not write it there later."""
    words = ["-q", "-j", "0", "-s", str(venv), "-p", final, str(venv / "lib")]
    subprocess.run([sys.executable, "-m", "compileall", *words], stdout=subprocess.DEVNULL, check=False)


def _minor() -> str:
    return "{}.{}".format(*sys.version_info[:2])


def default_python() -> Path:
    """Debian's interpreter of this very version: wheels are made for one."""
    return Path(f"/usr/bin/python{_minor()}")


def _run(command: list[str], what: str) -> None:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        last = (done.stderr or done.stdout).strip().splitlines()
        raise error("ARGUMENT_INVALID", f"{what} failed: {last[-1] if last else 'no reason given'}")


def _ordered(version: str) -> tuple[int, ...]:
    return tuple(int(number) for number in re.findall(r"\d+", version.partition("+")[0])[:3])
