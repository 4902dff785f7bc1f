"""Where things of the service belong, below any root: of an administrator, or of a package."""

from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

PROGRAMS = Path("opt/cellward")  # one folder a version, and the link 'current'
CONFIG = Path("etc/cellward/cell.toml")
NETWORK = Path("etc/systemd/system/cellward.service.d/50-cell-network.conf")
UNIT_OF_PACKAGE = Path("usr/lib/systemd/system/cellward.service")
COMMANDS = ("cellward", "cellward-twin")


@dataclass(frozen=True)
class Places:
    """Folders below a root: a package owns ``/usr``, an administrator has ``/etc`` and ``/usr/local``."""

    units: Path
    users: Path
    folders: Path
    rules: Path
    commands: Path
    manual: Path
    completion: Path

    def files(self) -> dict[Path, str]:
        """What is written where, but for the program: path below the root, and content."""
        return {
            self.units / "cellward.service": shipped("cellward.service"),
            self.users / "cellward.conf": shipped("sysusers.conf"),
            self.folders / "cellward.conf": shipped("tmpfiles.conf"),
            self.rules / "70-cellward.rules": shipped("70-cellward.rules"),
            self.completion / "cellward": shipped("completion.bash"),
        }


OF_ADMINISTRATOR = Places(
    units=Path("etc/systemd/system"),
    users=Path("etc/sysusers.d"),
    folders=Path("etc/tmpfiles.d"),
    rules=Path("etc/udev/rules.d"),
    commands=Path("usr/local/bin"),
    manual=Path("usr/local/share/man/man1"),
    completion=Path("etc/bash_completion.d"),
)
OF_PACKAGE = Places(
    units=UNIT_OF_PACKAGE.parent,
    users=Path("usr/lib/sysusers.d"),
    folders=Path("usr/lib/tmpfiles.d"),
    rules=Path("usr/lib/udev/rules.d"),
    commands=Path("usr/bin"),
    manual=Path("usr/share/man/man1"),
    completion=Path("usr/share/bash-completion/completions"),
)


def shipped(name: str) -> str:
    """The content of a file that ships with the program."""
    return files("daemon.service").joinpath("files", name).read_text("utf-8")
