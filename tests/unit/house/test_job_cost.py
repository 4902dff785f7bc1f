"""A trivial job of our own costs three lines; it is listed, checked, run, shown and has registers."""

import subprocess
import sys
from pathlib import Path

import pytest

from tests.job_cost import NAME, NUMBER, TREE, add_trivial_job

MOST_SHARED_LINES = 3
IN_THE_COPY = f'''
import sys
from pathlib import Path
import daemon
from daemon.cli.check import check
from daemon.cli.installed import list_installed
from daemon.words.result_text import result_text
from daemon.modbus import Command
from daemon.modbus.table import register_table
from daemon.plc import PlcFace
from fakes.object import VirtualClock, run_virtual
from tests.kit import object_cell

folder = Path(sys.argv[1])
assert Path(daemon.__file__).is_relative_to(folder), daemon.__file__

async def drawn(run): ...
import daemon.results
daemon.results._write_report = drawn

list_installed(False, True, False)
config = object_cell.write_config(folder, "belt", jobs={{"{NAME}": {{"seconds": 0.5}}}})
check(config=Path(config.source), probe=False, machine=False, drivers=False, jobs=False, as_json=False)
(names,) = [r.values for r in register_table().command if r.name == "job"]
print("register:", names[{NUMBER}])

async def main():
    async with object_cell.open_cell(config, VirtualClock(), "{NAME}") as cell:
        plc = PlcFace(config, cell.engine)
        print("result code:", await plc.handle(Command(1, 1, job={NUMBER})))
        await cell.clock.sleep(0.1)
        print("active job:", plc.snapshot()["active_job"])
        end = await cell.finished(1)
        print("ended:", end["outcome"], end["verdict"])
        print(result_text(cell.result(1)))
        print("run id:", plc.snapshot()["run_id"])

run_virtual(main())
'''


@pytest.fixture(scope="module")
def costs(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, int]]:
    tree = tmp_path_factory.mktemp("tree")
    return tree, add_trivial_job(tree)


def test_a_trivial_job_changes_three_lines_of_shared_files_at_most(
    costs: tuple[Path, dict[str, int]],
) -> None:
    tree, subject = costs
    assert all(subject.values())
    assert sum(subject.values()) <= MOST_SHARED_LINES, subject
    paths = [tree / name for name in subject if name.endswith(".py")]
    formatted = [
        sys.executable,
        "-m",
        "ruff",
        "format",
        "--diff",
        "--config",
        TREE / "pyproject.toml",
        *paths,
    ]
    done = subprocess.run(formatted, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr  # a line is one that the formatter leaves


def test_it_is_listed_checked_run_and_shown_and_its_registers_work(
    costs: tuple[Path, dict[str, int]],
) -> None:
    tree, _ = costs
    subject = subprocess.run(
        [sys.executable, "-P", "-c", IN_THE_COPY, str(tree)],
        env={"PYTHONPATH": str(tree)},
        cwd=tree,
        capture_output=True,
        text=True,
    )
    assert subject.returncode == 0, subject.stdout + subject.stderr
    lines = [line.split() for line in subject.stdout.splitlines()]
    assert [words for words in lines if words[:1] == [NAME]], "it is listed"
    for said in (
        "cell.toml",
        f"register: {NAME}",
        "result code: 1",
        f"active job: {NUMBER}",
        "ended: complete fail",
        f"{NAME}: verdict fail",
        "  the belt moved by ",
        "run id: 1",
    ):
        assert said in subject.stdout, (said, subject.stdout)


def test_without_a_folder_it_says_what_to_give() -> None:
    subject = subprocess.run(
        [sys.executable, TREE / "tests" / "job_cost.py"], capture_output=True, text=True, cwd=TREE
    )
    assert subject.returncode == 1
    assert subject.stderr == (
        "give the folder that the copy of the tree goes to: python tests/job_cost.py FOLDER\n"
    )
