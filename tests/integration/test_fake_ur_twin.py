"""``cellward-twin`` as people and the demo use it: one process, its children, its commands."""

import json
import signal
import subprocess
import sys
import time
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import psutil
import pytest
from fake_ur_client import Lines, Rtde, Text

pytestmark = pytest.mark.wire
HOST = "127.0.0.7"
COMMAND = [sys.executable, "-m", "fakes.cli"]


@dataclass
class Running:
    """A twin in a process of its own."""

    process: "subprocess.Popen[str]"
    folder: Path

    def call(self, *words: str) -> "subprocess.CompletedProcess[str]":
        return subprocess.run(
            [*COMMAND, *words, "--out", str(self.folder)],
            capture_output=True,
            text=True,
            timeout=20,
            check=False,
        )

    def truth(self) -> dict[str, Any]:
        value: dict[str, Any] = json.loads(self.call("truth", "--json").stdout)
        return value


def _start(folder: Path, *options: str) -> "subprocess.Popen[str]":
    words = ["--scenario", "hand_eye", "--bind", HOST, "--out", str(folder), *options]
    process = subprocess.Popen([*COMMAND, *words], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    for line in process.stdout:
        if line.startswith("ready"):
            return process
    raise AssertionError(f"the twin ended with {process.wait()}")


def _end(process: "subprocess.Popen[str]") -> None:
    process.send_signal(signal.SIGTERM)
    process.wait(10)
    assert process.stdout is not None
    process.stdout.close()


@pytest.fixture(scope="module")
def subject(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Running]:
    folder = tmp_path_factory.mktemp("twin")
    process = _start(folder, "--operator", "auto")
    yield Running(process, folder)
    _end(process)
    assert process.returncode == 0
    assert not (folder / "twin.sock").exists()
    assert not (folder / "frames.sock").exists()


def test_the_written_config_names_the_addresses_that_answer(subject: Running) -> None:
    config = tomllib.loads((subject.folder / "cell.toml").read_text())
    assert config["cell"]["twin"] is True
    assert config["device"]["arm"]["host"] == HOST
    with Lines(HOST) as dashboard:
        assert dashboard.ask("get serial number") == config["device"]["arm"]["expect_serial"]
    source = config["device"]["camera"]["source"]
    assert Path(source.removeprefix("frames+unix://")).is_socket()


def test_truth_tells_the_camera_and_the_arm(subject: Running) -> None:
    truth = subject.truth()
    assert truth["schema"] == "cellward.truth/1"
    assert len(truth["T_flange_camera"]) == 6
    assert truth["arm"]["serial"].startswith("9999")


def test_faults_are_injected_by_name_and_cleared(subject: Running) -> None:
    assert subject.call("fault", "protective-stop").returncode == 0
    assert subject.truth()["arm"]["safety_mode"] == "PROTECTIVE_STOP"
    assert subject.call("fault", "clear").returncode == 0
    assert subject.truth()["arm"]["safety_mode"] == "NORMAL"


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (("fault", "meltdown"), 2, "it has"),
        (("fault", "gap", "count=many"), 2, "not a number"),
        (("fault", "gap", "count"), 2, "key=value"),
        (("fault", "gap", "--device", "toaster"), 2, "no device"),
        (("operator", "place", "9"), 2, "does not exist"),
        (("--scenario", "hand_eye", "--bind", HOST), 4, "already runs"),
        (("--scenario", "nowhere"), 2, "neither a file nor a shipped scenario (bay, belt, "),
        (("--scenario", "hand_eye", "--bind", "10.0.0.1"), 2, "not a loopback address"),
    ],
)
def test_a_wrong_command_is_one_sentence_and_an_exit_code(
    subject: Running, words: tuple[str, ...], code: int, said: str
) -> None:
    done = subject.call(*words)
    assert done.returncode == code
    assert said in done.stderr
    assert "Traceback" not in done.stderr
    assert (subject.folder / "frames.sock").is_socket(), "the running twin keeps its camera"


def test_commands_without_a_twin_say_so(tmp_path: Path) -> None:
    done = Running(None, tmp_path).call("truth")  # type: ignore[arg-type]
    assert done.returncode == 3
    assert "no twin answers" in done.stderr
    assert "--scenario NAME" in done.stderr
    assert "--out" in done.stderr
    assert "power" not in done.stderr


def test_the_operator_places_the_target_counted_from_one(subject: Running) -> None:
    assert subject.call("operator", "place", "3").returncode == 0
    assert subject.truth()["placement"] == 2
    assert "placement 1" in subject.call("operator", "next").stdout
    assert subject.call("operator", "remove").returncode == 0
    assert subject.truth()["placement"] is None
    assert subject.call("operator", "place", "1").returncode == 0


def test_the_automatic_operator_moves_the_target_on_when_a_control_program_ends(subject: Running) -> None:
    subject.call("operator", "place", "1")
    control = 'def rtde_control():\n  textmsg("RTDE Control Script Loaded")\nend\n'
    with Text(HOST, 30003) as script, Rtde(HOST) as rtde:
        recipe, _ = rtde.inputs("input_int_register_0")
        script.send(control)
        time.sleep(0.1)
        assert subject.truth()["placement"] == 0
        rtde.send("U", bytes([recipe, 0, 0, 0, 255]))
        time.sleep(0.5)
        rtde.send("U", bytes([recipe, 0, 0, 0, 0]))
    assert subject.truth()["placement"] == 1


def test_a_killed_camera_comes_back_and_nothing_outlives_a_killed_twin(tmp_path: Path) -> None:
    process = _start(tmp_path, "--bind", "127.0.0.8")
    frames = tmp_path / "frames.sock"
    before = frames.stat().st_ino, frames.stat().st_ctime_ns
    assert Running(process, tmp_path).call("fault", "kill", "--device", "camera").returncode == 0
    deadline = time.monotonic() + 60.0
    while not frames.exists() or (frames.stat().st_ino, frames.stat().st_ctime_ns) == before:
        assert time.monotonic() < deadline, "the camera did not come back"
        time.sleep(0.05)
    children = psutil.Process(process.pid).children(recursive=True)
    assert children
    process.kill()
    process.wait()
    assert process.stdout is not None
    process.stdout.close()
    gone, alive = psutil.wait_procs(children, timeout=5)
    assert not alive
    assert len(gone) == len(children)


def test_a_process_can_be_made_to_end_with_its_parent() -> None:
    child = "\n".join(
        (
            "import signal, time",
            "from fakes.wire.lifetime import die_with_parent",
            "die_with_parent(signal.SIGTERM)",
            "print(1, flush=True)",
            "time.sleep(60)",
        )
    )
    parent = (
        "import os, subprocess, sys\n"
        f"p = subprocess.Popen([sys.executable, '-c', {child!r}],\n"
        "                     stdout=subprocess.PIPE)\n"
        "p.stdout.readline()\n"
        "os.write(1, str(p.pid).encode())\n"
        "os._exit(0)\n"
    )
    done = subprocess.run([sys.executable, "-c", parent], capture_output=True, timeout=20, check=True)
    deadline = time.monotonic() + 5.0
    while psutil.pid_exists(int(done.stdout)) and time.monotonic() < deadline:
        time.sleep(0.02)
    assert not psutil.pid_exists(int(done.stdout))
