"""``cellward place``: lines for the check of a fixed camera, out of the run of a capture."""

import json
import tomllib
from pathlib import Path
from typing import Any

import pytest

from cell.poses import from_pose6, log_xi
from procedures.eye_to_hand.config import EyeToHandCheckConfig
from tests.kit.cli_harness import CellOnDisk, CommandLine

CAPTURE = Path(__file__).parents[2] / "kit" / "stored_results" / "hand-eye-05.json"


@pytest.fixture
def subject(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> CommandLine:
    """In a cell with the board that run 1 saw."""
    cell, result = CellOnDisk(tmp_path), capture()
    board = {key: str(value).lower() if isinstance(value, bool) else repr(value) for key, value in
             result["inputs"]["target"].items()}  # fmt: skip
    lines = "\n".join(f"{key} = {value}" for key, value in board.items())
    cell.config.write_text(f"{cell.config.read_text()}[target.board]\n{lines}\n")
    cell.add_run(1, result, outcome="complete", verdict="pass")
    return CommandLine(monkeypatch, capsys, cell.config)


def capture() -> dict[str, Any]:
    result: dict[str, Any] = json.loads(CAPTURE.read_text())
    result["uncertainty"]["covers"] = ["arm", "gears", "sag", "lens", "target"]
    return result


def test_its_lines_are_a_section_of_the_configuration(subject: CommandLine) -> None:
    done = subject("place", 1)
    assert done.code == 0, done.err
    assert "such a check does not see" in done.err
    job = EyeToHandCheckConfig.model_validate(tomllib.loads(done.out)["job"]["eye-to-hand-check"])
    there = from_pose6(capture()["result"]["T_flange_target"]["1"])
    assert abs(log_xi(there * from_pose6(job.T_marker_flange))).max() < 1e-6
    assert (job.target, job.place_from) == ("board", "hand-eye")
    assert job.place_sigma_t_m > 1e-4
    assert json.loads(subject("place", 1, "--json").out)["placement"] == "1"


def test_what_it_cannot_take_is_one_sentence(subject: CommandLine) -> None:
    done = subject("place", 1, "--placement", "7")
    assert (done.code, done.out) == (2, "")
    assert "there is no placement 7; there is 0, 1" in done.err
