"""A working folder with packages of our names must not replace them in any child."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

SOLVER = """
import sys
from daemon import cli
from daemon.cli import app

def scene(**_):
    import asyncio
    from daemon.worker import ProcessWorker

    async def ask():
        worker = ProcessWorker()
        try:
            await worker.start()
        finally:
            await worker.stop()

    asyncio.run(ask())

if __name__ == "__main__":
    app.app = scene
    raise SystemExit(cli.main())
"""

VISION = """
import asyncio
from cell.clock import MonotonicClock
from drivers.life import Life
from drivers.oak.link import ChildLink

async def ask():
    life = Life("vision", MonotonicClock())
    life.begin()
    link = ChildLink("vision", life, lambda message: None)
    await link.start("daemon.vision_child")
    await asyncio.sleep(0.5)
    await link.close()
"""

TWIN = """
import multiprocessing
import sys
from fakes import cli

def scene():
    child = multiprocessing.get_context("spawn").Process(target=print)  # as the twin starts its own
    child.start()
    child.join(30.0)
    sys.exit(child.exitcode)

if __name__ == "__main__":
    cli.app = scene
    cli.main()
"""


@pytest.fixture
def shadowed(tmp_path: Path) -> Path:
    """A folder whose modules leave a mark when they are imported."""
    mark = f"open({str(tmp_path / 'imported')!r}, 'a').write(__name__ + chr(10))\n"
    for name in ("daemon", "drivers", "fakes", "calibration", "cell", "procedures"):
        package = tmp_path / name
        package.mkdir()
        (package / "__init__.py").write_text(mark, "utf-8")
    # What the spawn of a child imports before it takes over its parent's search path.
    (tmp_path / "runpy.py").write_text(mark, "utf-8")
    (tmp_path / "signal.py").write_text(mark + "raise ImportError('shadow')\n", "utf-8")
    return tmp_path


@pytest.mark.parametrize(
    "script", [SOLVER, VISION + "\nasyncio.run(ask())\n", TWIN], ids=["solver", "vision", "twin"]
)
def test_a_child_takes_no_module_from_the_folder_it_is_started_in(shadowed: Path, script: str) -> None:
    program = shadowed / "bin" / "program.py"
    program.parent.mkdir()
    program.write_text(script, "utf-8")
    clean = {k: v for k, v in os.environ.items() if k != "PYTHONSAFEPATH"}
    done = subprocess.run(
        [sys.executable, str(program)], cwd=shadowed, env=clean, capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stderr
    mark = shadowed / "imported"
    assert not mark.exists(), mark.read_text("utf-8")
