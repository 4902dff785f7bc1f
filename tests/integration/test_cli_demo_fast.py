"""The fast demo as a person runs it, and the commands that read what it leaves."""

import json
from pathlib import Path

import pytest

from cell.store.files import read_json
from daemon.cli import main
from daemon.demo.fast import ROWS_FILE, STATE, run_fast
from daemon.demo.steps import steps_of
from tests.kit.log_handlers import logging_as_before

__all__ = ["logging_as_before"]
pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("logging_as_before")]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("demo")


def test_the_fast_demo_agrees_with_the_truth_and_replays(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert run_fast(folder, steps_of(["cone-capture"])) == 0
    shown = capsys.readouterr()
    assert "no protocol" in shown.out
    assert "consistent with the stated uncertainty" in shown.out
    assert "the corrected arm is consistent with what is stated of it" in shown.out
    assert "NOT consistent" not in shown.out
    config = str(folder / "workshop" / "fast.toml")

    def cellward(*words: str) -> str:
        monkeypatch.setattr("sys.argv", ["cellward", *words, "--config", config])
        capsys.readouterr()
        assert main() == 0
        return capsys.readouterr().out

    assert json.loads(cellward("replay", "1", "--json"))["same"] is True
    assert [(r["run_id"], r["outcome"]) for r in json.loads(cellward("runs", "--json"))] == [(1, "complete")]
    (proposed,) = json.loads(cellward("results", "--json"))
    assert (proposed["name"], proposed["state"], proposed["run_id"]) == ("T_flange_camera", "proposed", 1)
    assert "placement 3 of 3" in cellward("show", "1")


def test_the_fast_demo_samples_an_arm_with_a_stored_set(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_fast(folder, steps_of(["tracker-sampling"])) == 0
    shown = capsys.readouterr().out
    assert "15 poses of this run, 3 of them set aside, solved together with a stored set of 40 poses" in shown
    assert "consistent with the promise" in shown
    assert "NOT consistent" not in shown


@pytest.mark.parametrize("ideal", [False, True])
def test_the_fast_demo_picks_by_the_belt_that_it_has_calibrated(
    folder: Path, ideal: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    out = folder / str(ideal)
    assert run_fast(out, steps_of(["belt-tracking"]), ideal) == 0
    shown = capsys.readouterr().out
    assert "NOT consistent" not in shown
    assert "belt.nominal" not in shown
    assert [row["job"] for row in read_json(out / ROWS_FILE)] == ["belt-calibration", "belt-tracking"]
    (picks,) = (out / "picking" / STATE / "runs").glob("*_belt-tracking_*")
    stated = read_json(picks / "result.json")["result"]["contact_95_m"]
    assert 0.0003 < stated < 0.003, "by a belt that nobody has calibrated it was 0.008 m"


@pytest.mark.parametrize(
    ("job", "told"),
    [
        ("latency-calibration", ["the camera late by", "the encoder late by"]),
        ("corrected-targets", ["what is stated of a target is up to"]),
        ("cross-check", ["touch-test", "truly changed: tool by 1.500", "fail, as it should"]),
    ],
)
def test_the_fast_demo_agrees_with_the_truth_in(
    job: str, told: list[str], folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_fast(folder, steps_of([job])) == 0
    shown = capsys.readouterr().out
    assert "NOT" not in shown
    assert [words for words in told if words not in shown] == []


def test_the_fast_demo_grades_a_fixed_camera(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """By the lens that its calibration found, which is not known exactly."""
    assert run_fast(folder, steps_of(["eye-to-hand-check"])) == 0
    assert "NOT consistent" not in capsys.readouterr().out
