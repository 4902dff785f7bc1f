"""The demo's driver from start to end, against stand-ins for the two commands that it starts."""

import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import psutil
import pytest

from daemon.demo import beside, wire
from daemon.demo.steps import CONE_CAPTURE
from daemon.demo.wire import run_wire as run_steps

STEPS = [CONE_CAPTURE]
STAND_INS = {
    "cellward-twin": Path(__file__).with_name("demo_twin_stand_in.py"),
    "cellward": Path(__file__).with_name("demo_daemon_stand_in.py"),
}
NOTHING_BESIDE = """#!/bin/sh
while [ "$1" != --out ]; do shift; done
mkdir -p "$2" && echo "[]" > "$2/rows.json"
"""
TRUTH = {"T_flange_camera": [0.006, -0.0864, 0.0548, 0.0, 0.0, 0.0]}
pytestmark = pytest.mark.wire


def run_wire(folder: Path) -> int:
    return run_steps(folder.parent, STEPS)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of the demo's first twin; its commands are the stand-ins."""
    for command, stand_in in STAND_INS.items():
        script = tmp_path / "bin" / command
        script.parent.mkdir(exist_ok=True)
        script.write_text(f'#!/bin/sh\nexec "{sys.executable}" "{stand_in}" "$@"\n')
        script.chmod(0o755)
    monkeypatch.setattr(wire, "console_script", lambda name: tmp_path / "bin" / name)
    nothing = tmp_path / "bin" / "nothing"
    nothing.write_text(NOTHING_BESIDE)
    nothing.chmod(0o755)
    monkeypatch.setattr(beside, "console_script", lambda name: nothing)
    demo = tmp_path / "out" / CONE_CAPTURE.twin
    demo.mkdir(parents=True)
    with socket.socket() as free:
        free.bind(("127.0.0.11", 0))
        (demo / "port").write_text(str(free.getsockname()[1]))
    (demo / "truth.json").write_text(json.dumps(TRUTH))
    (demo / "mode").write_text("complete")
    return demo


def children() -> list[psutil.Process]:
    return [c for c in psutil.Process().children(recursive=True) if "_stand_in.py" in " ".join(c.cmdline())]


def test_a_good_run_ends_with_0_and_shows_the_answer_beside_the_truth(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_wire(folder) == 0
    shown = capsys.readouterr()
    assert shown.out.splitlines()[0].startswith("Cellward demo")
    assert "ETA" in shown.out.splitlines()[0]
    assert (folder / "placed").read_text() == "1\n"
    for told in ("6.05000", "6.00000", "consistent with the stated", "report.html"):
        assert told in shown.out
    assert "over Modbus" in shown.err
    assert children() == []


def test_a_run_that_was_held_is_resumed(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """As the daemon holds it when the demo's own PLC had no core for a while."""
    (folder / "mode").write_text("hold")
    assert run_wire(folder) == 0
    assert capsys.readouterr().err.count("run 7 was held") == 1


def test_demos_that_begin_at_the_same_moment_take_different_addresses() -> None:
    with wire.free_address() as first, wire.free_address() as second:
        assert first != second
    with wire.free_address() as again:
        assert again == first


@pytest.mark.parametrize(
    ("mode", "told"),
    [("beyond", "NOT consistent with"), ("abort", "The board was not seen: at pose 3 (5001)")],
)
def test_a_run_that_is_not_good_ends_with_1(
    folder: Path, capsys: pytest.CaptureFixture[str], mode: str, told: str
) -> None:
    (folder / "mode").write_text(mode)
    assert run_wire(folder) == 1
    shown = capsys.readouterr()
    assert told in shown.out + shown.err
    assert children() == []


def test_a_daemon_that_dies_is_told_with_its_last_words_and_fails_the_demo(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "mode").write_text("die")
    assert run_wire(folder) == 1
    shown = capsys.readouterr()
    assert "not done: A helper process of a device ended: the daemon ended with code" in shown.out
    assert "the arm fell off" in (folder / "daemon.log").read_text()
    assert children() == []


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_demo_leaves_no_process(folder: Path, number: signal.Signals) -> None:
    before = signal.getsignal(number)

    def interrupt() -> None:
        give_up = time.monotonic() + 20
        while not (folder / "placed").exists() and time.monotonic() < give_up:
            threading.Event().wait(0.02)
        os.kill(os.getpid(), number)

    interrupter = threading.Thread(target=interrupt)
    interrupter.start()
    with pytest.raises(KeyboardInterrupt):
        run_wire(folder)
    interrupter.join()
    assert children() == []
    assert signal.getsignal(number) is before


def test_a_twin_that_cannot_start_is_named_with_its_reason(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "port").unlink()
    assert run_wire(folder) == 1
    assert "the twin ended with code 1" in capsys.readouterr().out
    assert children() == []


def test_the_demo_command_refuses_a_job_it_does_not_have() -> None:
    command = [Path(sys.executable).with_name("cellward"), "demo", "--job", "drift-check"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=30)
    assert done.returncode == 4
    assert "drift-check" in done.stderr
