"""``python -m daemon.service.stage ROOT WHEELHOUSE``: the files of a package below ROOT; says the version."""

import sys
from pathlib import Path

import typer

from daemon.cli.app import app
from daemon.cli.manual import man_page
from daemon.service.install import stage_package
from daemon.service.program import default_python

if __name__ == "__main__":
    root, wheelhouse = (Path(word).absolute() for word in sys.argv[1:3])
    page = man_page(typer.main.get_command(app)) + "\n"
    sys.stdout.write(stage_package(root, wheelhouse, default_python(), page) + "\n")
