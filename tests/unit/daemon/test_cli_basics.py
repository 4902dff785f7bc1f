"""Help, explain, init, configuration faults, and how unforeseen failures end."""

import json
import os
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer.main
from rich.text import Text

from cell.errors import catalogue
from daemon.cli import failures, setup
from daemon.cli.app import app
from tests.kit.cli_harness import SHELL_DETECTION, CellOnDisk, CommandLine

COMMANDS = [
    "demo", "init", "run", "check", "status", "watch", "start", "confirm", "finish", "abort", "halt", "pause",
    "resume", "reset", "runs", "show", "report", "compare", "replay", "adopt", "results", "accept", "reject",
    "rollback", "solve", "explain", "config",
]  # fmt: skip


@pytest.fixture
def subject(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> CommandLine:
    return CommandLine(monkeypatch, capsys, CellOnDisk(tmp_path).config)


def test_help_lists_every_command_of_the_manual(subject: CommandLine) -> None:
    shown = subject("--help")
    assert shown.code == 0
    for command in COMMANDS:
        assert f" {command} " in shown.out
        assert subject(command, "--help").code == 0


def test_no_help_loses_a_name_in_brackets_as_markup(subject: CommandLine) -> None:
    for name, command in every_command(typer.main.get_command(app), ()):
        texts = [command.help, *(getattr(parameter, "help", None) for parameter in command.params)]
        for text in filter(None, texts):
            assert Text.from_markup(text).plain == text.replace(r"\[", "["), name
    assert "its section [job.NAME] is called" in subject("rehearse", "--help").out
    assert "its section [job.NAME] is called" in subject("man").out


def every_command(command: Any, name: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], Any]]:
    """``command`` and all below it, each with the words that call it."""
    yield name, command
    for word, below in getattr(command, "commands", {}).items():
        yield from every_command(below, (*name, word))


def test_the_manual_page_has_every_command_and_none_of_roffs_complaints(subject: CommandLine) -> None:
    page = subject("man").out
    for command in COMMANDS:
        assert f".SS {command}" in page
    assert "cellward 0." in page.splitlines()[0]
    if groff := shutil.which("groff"):
        done = subprocess.run(
            [groff, "-man", "-ww", "-z", "-Tutf8"], input=page, capture_output=True, text=True, timeout=60
        )
        assert (done.returncode, done.stderr) == (0, "")


def test_completion_can_be_shown_for_a_shell(subject: CommandLine, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(SHELL_DETECTION, "1")
    done = subject("--show-completion", "bash")
    assert done.code == 0
    assert "_CELLWARD_COMPLETE" in done.out


def test_every_record_says_which_version_made_it(subject: CommandLine, tmp_path: Path) -> None:
    version = subject("--version").out.strip()
    assert version.startswith("cellward 0.")
    cell = CellOnDisk(tmp_path)
    folder = cell.add_run(1, outcome="complete", verdict="pass").path
    assert json.loads((folder / "end.json").read_text())["software"] == version


def test_a_mistyped_command_is_a_usage_error_with_a_suggestion(subject: CommandLine) -> None:
    done = subject("sttus")
    assert done.code == 2
    assert "status" in done.err


def test_a_demo_in_ideal_worlds_alone_has_no_protocols(subject: CommandLine) -> None:
    done = subject("demo", "--ideal")
    assert done.code == 2
    assert "--ideal needs --fast" in done.err


@pytest.mark.parametrize("name", sorted(catalogue()))
def test_every_error_is_explained_by_number_and_by_name(subject: CommandLine, name: str) -> None:
    by_name, by_number = subject("explain", name), subject("explain", catalogue()[name].code, "--json")
    assert (by_name.code, by_number.code) == (0, 0)
    assert catalogue()[name].hint in by_name.out
    assert json.loads(by_number.out)["name"] == name


def test_an_unknown_error_code_gets_a_suggestion(subject: CommandLine) -> None:
    done = subject("explain", "arm_protective_stp")
    assert done.code == 2
    assert "ARM_PROTECTIVE_STOP" in done.err


def test_init_writes_valid_toml_and_never_over_a_file(subject: CommandLine, tmp_path: Path) -> None:
    path = tmp_path / "new.toml"
    assert tomllib.loads(subject("init").out)["schema"] == 1
    assert subject("init", "-o", path).code == 0
    before = path.read_text()
    done = subject("init", "-o", path)
    assert (done.code, path.read_text()) == (2, before)
    assert "not overwritten" in done.err
    assert subject("init", "-o", tmp_path / "no" / "folder.toml").code == 2


@pytest.mark.parametrize("command", ["status", "runs", "check", "run", "results"])
def test_a_missing_configuration_says_how_to_make_one(
    subject: CommandLine, tmp_path: Path, command: str
) -> None:
    done = subject(command, "--config", tmp_path / "absent.toml")
    assert done.code == 2
    assert "cellward init" in done.err


@pytest.mark.parametrize("content", [b"not toml [", b"\xff\xfe"])
def test_a_configuration_that_is_no_toml_is_named(
    subject: CommandLine, tmp_path: Path, content: bytes
) -> None:
    path = tmp_path / "broken.toml"
    path.write_bytes(content)
    done = subject("status", "--config", path)
    assert done.code == 2
    assert str(path) in done.err


def test_an_unforeseen_failure_is_one_line_and_a_file_with_the_details(
    subject: CommandLine, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(failures.tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(setup, "find_entry", lambda code: 1 / 0)
    done = subject("explain", "3001")
    assert (done.code, done.out) == (5, "")
    assert "division by zero" in done.err
    assert "Traceback" not in done.err
    (log,) = tmp_path.glob("cellward-error-*.log")
    assert str(log) in done.err
    assert "Traceback" in log.read_text()


def test_ctrl_c_is_no_failure_of_the_program(subject: CommandLine, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(code: str) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(setup, "find_entry", interrupted)
    done = subject("explain", "3001")
    assert done.code in (1, 130)
    assert "Traceback" not in done.err


@pytest.mark.wire
def test_a_reader_that_goes_away_is_no_failure(tmp_path: Path) -> None:
    read, write = os.pipe()
    os.close(read)
    command = [Path(sys.executable).with_name("cellward"), "init"]
    done = subprocess.run(command, stdout=write, stderr=subprocess.PIPE, text=True, timeout=30)
    os.close(write)
    assert (done.returncode, done.stderr) == (0, "")


def test_a_result_of_too_few_poses_to_leave_one_out_is_printed_without_that_line() -> None:
    from daemon.words.result_text import result_text
    from tests.kit.whole_results import whole

    pose = [0.0, -0.08, 0.05, 0.0, 0.0, 0.0]
    residuals = {"spread_mean": {"t": 1e-4, "r": 1e-4}, "loo_mean": {}, "reprojection_rms_px": 0.1}
    named = {"kind": "hand-eye", "verdict": "pass", "result": {"T_flange_camera": pose}}
    text = result_text(whole(named | {"residuals": residuals}))
    assert "0.100 mm" in text
    assert "did not see it" not in text
