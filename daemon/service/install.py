"""``cellward install`` and ``uninstall``: files below a root, made and removed; the data stay."""

import os
import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from cell.errors import error
from daemon.config import CellConfig
from daemon.service.network import drop_in, subnets
from daemon.service.places import (
    COMMANDS,
    CONFIG,
    NETWORK,
    OF_ADMINISTRATOR,
    OF_PACKAGE,
    PROGRAMS,
    UNIT_OF_PACKAGE,
    Places,
)
from daemon.service.program import (
    CURRENT,
    installed,
    make_program,
    refuse_older,
    remove_programs,
    wheel_version,
)


@dataclass
class Done:
    """What was done, and what is left to a person; each a sentence."""

    did: list[str] = field(default_factory=list)
    left: list[str] = field(default_factory=list)


def of_package(root: Path) -> bool:
    """Whether a package has brought the unit: then its files are the package's."""
    return (root / UNIT_OF_PACKAGE).is_file()


def install(
    root: Path,
    wheelhouse: Path | None,
    python: Path,
    manual: str,
    config: CellConfig | None,
    allow: Sequence[str],
) -> Done:
    """Put program, user, unit, rules and networks in place, or up to date; what is there is written anew.

    ``root`` is ``/`` or a folder that becomes one. ``INSTALL_REFUSED`` for an older program than is in use.
    """
    done = Done()
    if not of_package(root):
        present = installed(root)
        if wheelhouse is not None:
            version = wheel_version(wheelhouse)
            refuse_older(version, present)
            if not (root / python.relative_to("/")).exists():
                raise error(
                    "ARGUMENT_INVALID",
                    f"there is no {python} below {root}: 'apt install {python.name}' there, or name another "
                    "of the same version with --python",
                )
            make_program(root, wheelhouse, version, python, packaged=False)
            done.did.append(f"cellward {version} is in /{PROGRAMS / version}" + _before(present, version))
        elif present is None:
            raise error(
                "ARGUMENT_INVALID", "the program is not there yet: give its wheels with --wheelhouse FOLDER"
            )
        write_files(root, OF_ADMINISTRATOR, manual)
        done.did.append("unit, user, folders and udev rules are in place")
    _make_users_and_folders(root, done)
    if config is None:
        done.left += [
            f"Write the configuration: cellward init -o /{CONFIG}",
            "Then, so that the service may reach the addresses in it: cellward install",
        ]
    else:
        networks = subnets(config, allow)
        _write(root / NETWORK, drop_in(networks))
        named = ", ".join(map(str, networks)) or "this computer alone"
        done.did.append(f"the service may reach {named}")
    _tell_systemd(root, done)
    done.left.append("Each person who uses the command line: usermod -aG cellward NAME, and log in again")
    return done


def write_files(root: Path, places: Places, manual: str) -> None:
    """Everything but the program below ``root``; the commands are links to the version in use."""
    for path, content in places.files().items():
        _write(root / path, content)
    _write(root / places.manual / "cellward.1", manual)
    folder = root / places.commands
    folder.mkdir(parents=True, exist_ok=True)
    for name in COMMANDS:
        link = folder / name
        if link.exists() and not link.is_symlink():
            raise error("ARGUMENT_INVALID", f"{link} is a file of something else; move it away")
        link.unlink(missing_ok=True)
        link.symlink_to(f"/{PROGRAMS / CURRENT}/bin/{name}")


def stage_package(root: Path, wheelhouse: Path, python: Path, manual: str) -> str:
    """The files of a package below the empty ``root``; returns the version."""
    version = wheel_version(wheelhouse)
    make_program(root, wheelhouse, version, python, packaged=True)
    write_files(root, OF_PACKAGE, manual)
    return version


def uninstall(root: Path) -> Done:
    """Remove what :func:`install` has made. Configuration, runs, results and the user stay."""
    if of_package(root):
        raise error("INSTALL_REFUSED", "cellward came as a package: remove it with 'apt remove cellward'")
    if installed(root) is None and not (root / OF_ADMINISTRATOR.units / "cellward.service").exists():
        raise error("INSTALL_REFUSED", f"cellward is not installed below {root}")
    done = Done()
    if _is_running_system(root):
        _systemctl("disable", "--now", "cellward.service")
    for path in (*OF_ADMINISTRATOR.files(), OF_ADMINISTRATOR.manual / "cellward.1", NETWORK):
        (root / path).unlink(missing_ok=True)
    for name in COMMANDS:
        if (link := root / OF_ADMINISTRATOR.commands / name).is_symlink():
            link.unlink()
    if (folder := root / NETWORK.parent).is_dir() and not any(folder.iterdir()):
        folder.rmdir()
    remove_programs(root)
    _tell_systemd(root, done)
    done.did.append("program, unit, rules and commands are removed")
    done.left.append("/etc/cellward and /var/lib/cellward are kept, with the user that owns them")
    return done


def _before(present: str | None, version: str) -> str:
    return f"; {present} is kept beside it" if present not in (None, version) else ""


def _make_users_and_folders(root: Path, done: Done) -> None:
    places = OF_PACKAGE if of_package(root) else OF_ADMINISTRATOR
    for tool, folder in (("systemd-sysusers", places.users), ("systemd-tmpfiles", places.folders)):
        if shutil.which(tool) is None:
            done.left.append(f"{tool} is not installed here: run it on the machine itself")
            continue
        create = ["--create"] if tool == "systemd-tmpfiles" else []
        file = root / folder / "cellward.conf"
        ran = subprocess.run(
            [tool, f"--root={root}", *create, str(file)], capture_output=True, text=True, check=False
        )
        if ran.returncode != 0:
            raise error("ARGUMENT_INVALID", f"{tool} failed: {ran.stderr.strip().splitlines()[-1:]}")
    done.did.append("user and group cellward, /etc/cellward and /var/lib/cellward are there")


def _tell_systemd(root: Path, done: Done) -> None:
    if not _is_running_system(root):
        return
    _systemctl("daemon-reload")
    if shutil.which("udevadm"):
        # It does not run in a container, where devices are the host's.
        reloaded = subprocess.run(["udevadm", "control", "--reload"], capture_output=True, check=False)
        if reloaded.returncode == 0:
            subprocess.run(["udevadm", "trigger"], check=False)
        else:
            done.left.append("udev does not run here: where devices are plugged in, udevadm control --reload")
    if _systemctl("is-active", "--quiet", "cellward.service") == 0:
        done.left.append("When no job runs: systemctl restart cellward")


def _is_running_system(root: Path) -> bool:
    return root.resolve() == Path("/") and Path("/run/systemd/system").is_dir()


def _systemctl(*words: str) -> int:
    return subprocess.run(["systemctl", *words], check=False).returncode


def _write(path: Path, content: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    draft = path.with_name(path.name + ".new")
    draft.write_text(content, "utf-8")
    os.chmod(draft, 0o644)
    draft.replace(path)
