"""The example package beside a real daemon: started by number and by name, reported, read by commands."""

import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from pyModbusTCP.client import ModbusClient

from cell.errors import CellError
from cell.store.runs import RunFolder, load_run
from daemon.control_client import ControlClient
from tests.kit.cli_harness import CommandLine, Ran

pytestmark = [pytest.mark.wire, pytest.mark.slow]
EXAMPLE = Path(__file__).parents[2] / "docs/examples/acme"
HOST, PORT = "127.0.0.61", 5861
CELLWARD = Path(sys.executable).parent / "cellward"
INSTALLED, CONFIGURED = "installed", "configured"
NUMBER = 1001  # of the job
BEGINNING = (
    'schema = 1\n[cell]\nname = "acme"\ntwin = true\nstate_dir = "{0}/state"\ncontrol_socket = "{0}/s"\n'
)
CELL = """
[robot]
belt = "belt"
[modbus]
bind = "{host}:{port}"
allow_write = true
allow_clients = ["127.0.0.0/8"]
[device.belt]
driver = "{driver}"
[job.acme-still]
{procedure}
seconds = {seconds}
"""


def is_one_sentence(ran: Ran) -> bool:
    """An error with its hint, and nothing else."""
    lines = ran.err.strip().splitlines()
    return not ran.out and len(lines) <= 2 and lines[0].startswith("Error ") and "Traceback" not in ran.err


@dataclass
class Daemon:
    """A daemon whose cell has the encoder and the job of the example."""

    folder: Path
    env: dict[str, str]

    @property
    def config(self) -> Path:
        return self.folder / "cell.toml"

    def command(self, *words: object, config: Path | None = None) -> Ran:
        named = {"CELLWARD_CONFIG": str(config or self.config)}
        return self.command_in(self.env | named, *words)

    @staticmethod
    def command_in(env: dict[str, str], *words: object) -> Ran:
        done = subprocess.run(
            [CELLWARD, *map(str, words)], env=env, capture_output=True, text=True, timeout=60.0
        )
        return Ran(done.returncode, done.stdout, done.stderr)

    def status(self) -> dict[str, Any]:
        with ControlClient(self.folder / "s") as client:
            found: dict[str, Any] = client.call("status")
            return found

    def ready(self) -> bool:
        try:
            return all(d["state"] == "READY" for d in self.status()["devices"].values())
        except CellError:
            return False

    def ended(self, run_id: int) -> bool:
        last = self.status()["last_run"]
        return last is not None and last["run_id"] == run_id

    def run(self, run_id: int) -> RunFolder:
        return load_run(self.folder / "state/runs", run_id)


def wait_for(true: Callable[[], bool], what: str, limit_s: float = 60.0) -> None:
    give_up = time.monotonic() + limit_s
    while not true():
        assert time.monotonic() < give_up, f"no {what} within {limit_s:g} s"
        time.sleep(0.05)


def site_with(example: str, folder: Path) -> Path:
    """What is put on the path: the package as pip installs it, or its bare sources without entry points."""
    shutil.copytree(EXAMPLE, folder / "source")
    if example == CONFIGURED:
        return folder / "source"
    how = ["--no-deps", "--no-build-isolation", "--no-index", "--quiet", "--disable-pip-version-check"]
    pip = [sys.executable, "-m", "pip", "install", *how, "--target", str(folder / "site")]
    subprocess.run([*pip, str(folder / "source")], check=True, capture_output=True)
    return folder / "site"


@pytest.fixture(scope="module", params=[pytest.param(INSTALLED, marks=pytest.mark.soak), CONFIGURED])
def subject(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Daemon]:
    folder = tmp_path_factory.mktemp("acme")
    env = os.environ | {"PYTHONPATH": str(site_with(request.param, folder))}
    named = request.param == CONFIGURED
    text = BEGINNING.format(folder) + CELL.format(
        host=HOST,
        port=PORT,
        driver="acme_belt.encoder:AcmeEncoder" if named else "acme-encoder",
        procedure='procedure = "acme_belt.still:BeltStill"' if named else "",
        seconds=0.3,
    )
    (folder / "cell.toml").write_text(text, "utf-8")
    (folder / "cell.toml").chmod(0o600)
    (folder / "no-job.toml").write_text(BEGINNING.format(folder), "utf-8")
    daemon = Daemon(folder, env)
    with (folder / "daemon.log").open("wb") as log:
        process = subprocess.Popen([CELLWARD, "run", "-c", daemon.config], env=env, stdout=log, stderr=log)
    try:
        wait_for(daemon.ready, "ready devices")
        _start_by_number(daemon)
        _start_by_name(daemon)
        yield daemon
    finally:
        process.terminate()
        process.wait(20.0)


def _start_by_number(daemon: Daemon) -> None:
    """Run 1, as a PLC starts it."""
    plc = ModbusClient(HOST, PORT, auto_open=True, timeout=5.0)
    try:
        assert plc.write_multiple_registers(0, [1, 1, NUMBER, 0, 0, 0, 0, 0, 0, 0])
        wait_for(lambda: (plc.read_input_registers(1, 2) or [0])[0] == 1, "acknowledged command")
        assert plc.read_input_registers(2, 1) == [1], "accepted"
        wait_for(lambda: daemon.ended(1), "end of run 1")
    finally:
        plc.close()


def _start_by_name(daemon: Daemon) -> None:
    """Run 2, as a person starts it."""
    done = daemon.command("start", "acme-still", "--wait")
    assert done.code == 0, done.err
    assert "the belt moved by 0 counts" in done.out


def test_both_ways_of_starting_give_a_run_with_its_result(subject: Daemon) -> None:
    for run_id in (1, 2):
        run = subject.run(run_id)
        assert run.job == "acme-still"
        end, result = run.read_end(), run.read_result()
        assert end is not None
        assert (end["outcome"], end["verdict"]) == ("complete", "pass")
        assert result is not None
        assert result["result"] == {"counts": 0}


def test_the_process_worker_draws_its_report(subject: Daemon) -> None:
    for run_id in (1, 2):
        assert [line for line in subject.run(run_id).read_journal() if line.get("event") == "no report"] == []
        page = (subject.run(run_id).path / "report.html").read_text("utf-8")
        assert "acme" in page


@pytest.mark.parametrize("command", ["show", "report"])
def test_its_run_is_shown_and_reported(subject: Daemon, command: str) -> None:
    rebuild = ["--rebuild", "--no-open"] if command == "report" else []
    done = subject.command(command, 1, *rebuild)
    assert (done.code, done.err) == (0, "")


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("compare", 1, 2), "results of kind acme_belt.still:KIND have no comparison"),
        (("replay", 1), "the job acme-still keeps no data set, so it cannot be replayed"),
    ],
)
def test_what_its_kind_lacks_is_one_sentence(subject: Daemon, words: tuple[object, ...], says: str) -> None:
    done = subject.command(*words)
    assert (done.code, is_one_sentence(done)) == (2, True), done.err
    assert says in done.err


def test_its_numbers_are_followed_live(subject: Daemon) -> None:
    idle = subject.command("live")
    assert (idle.code, is_one_sentence(idle)) == (4, True), idle.err
    started = subject.command("start", "acme-still", "-p", "seconds=20")
    assert started.code == 0, started.err
    try:
        done = subject.command("live", "--for", 0.3)
        assert (done.code, done.err) == (0, "")
        assert done.out.splitlines()[0] == "nothing yet"
    finally:
        assert subject.command("abort").code == 0
    wait_for(lambda: subject.status()["job"] is None, "end of the job")
    newest = max((subject.folder / "state" / "runs").iterdir(), key=lambda run: run.name)
    wait_for((newest / "report.html").exists, "report of the aborted run, which a process of its own draws")


# In this process, which has nothing of the example on its path.


def test_without_a_configuration_each_command_says_which_is_missing(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    missing = Path("/etc/cellward/cell.toml")
    if missing.exists():
        pytest.skip(f"this machine has a {missing}")
    command = CommandLine(monkeypatch, capsys, None)
    for words in (("compare", 1, 2), ("replay", 1), ("live",), ("show", 1)):
        done = command(*words)
        assert (done.code, is_one_sentence(done)) == (2, True), (words, done.err)
        assert f"there is no configuration {missing}; name one with --config" in done.err


def test_where_no_configuration_names_its_job_each_command_says_so(
    subject: Daemon, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    command = CommandLine(monkeypatch, capsys, subject.folder / "no-job.toml")
    for words in (("compare", 1, 2), ("replay", 1), ("report", 1, "--rebuild")):
        done = command(*words)
        assert (done.code, is_one_sentence(done)) == (2, True), (words, done.err)
        assert "install" in done.err
        assert "[job." in done.err
        assert "procedure" in done.err


def test_a_package_that_is_gone_is_named_beside_the_line_that_names_it(subject: Daemon) -> None:
    if "procedure" not in subject.config.read_text("utf-8"):
        pytest.skip("this cell.toml has the job of an installed package")
    done = Daemon.command_in(
        subject.env | {"PYTHONPATH": "", "CELLWARD_CONFIG": str(subject.config)}, "compare", 1, 2
    )
    assert done.code == 2
    assert "job.acme-still.procedure: job 'acme_belt.still:BeltStill' cannot be loaded" in done.err
    assert "Traceback" not in done.err


def test_the_registers_and_the_list_of_runs_have_it(subject: Daemon) -> None:
    rows = json.loads(subject.command("runs", "--json").out)
    assert {row["job"] for row in rows} == {"acme-still"}
    plc = ModbusClient(HOST, PORT, auto_open=True, timeout=5.0)
    try:
        words = plc.read_input_registers(0, 64)
    finally:
        plc.close()
    assert words is not None
    assert words[1] == 1, "the sequence of the only command"
