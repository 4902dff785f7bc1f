"""What a rehearsal tells beside its verdict: what was played before, warnings, and what no limit covers."""

from pathlib import Path
from typing import Any

import pytest

from cell.clock import MonotonicClock
from cell.store.runs import RunFolder
from daemon.config import load_config
from daemon.rehearsal.play import NOT_STARTED, RehearsedRun, rehearse
from daemon.rehearsal.words import outcome_lines, twin_lines
from tests.kit.cli_harness import CommandLine
from tests.kit.example_cell import whole_example
from tests.kit.log_handlers import logging_as_before
from tests.kit.whole_results import whole

__all__ = ["logging_as_before"]
pytestmark = pytest.mark.usefixtures("logging_as_before")

MISSED = {"code": "belt.out-of-zone", "text": "13 missed: out of zone"}
DELAYS = {"code": "belt.delays", "text": "how late the stamps are was not measured: 0.370 mm (95 %)"}
CONTACT = {"off_m": [0.0, 0.0], "slide_m_s": 0.0, "taken": True}
TRUTH = {"belt": {"dir": [1.0, 0.0, 0.0]}, "gripper": {"contacts": [CONTACT]}}


def picking(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, calibration: str | None) -> RehearsedRun:
    """Of a picking run that warns, behind a calibration of the belt with that verdict; None: it stopped."""
    answer = {"picks": 1, "contact_95_m": 0.001, "contact_95_without": ["the camera's pose", "a slope"]}
    first: dict[str, Any] = {"kind": "belt-calibration", "result": None, "verdict": calibration}
    then = {
        "kind": "belt-tracking",
        "verdict": "warn",
        "result": answer,
        "reasons": [MISSED["text"]],
        "warnings": [MISSED, DELAYS, DELAYS],
    }

    def played(config: Any, steps: Any) -> tuple[list[tuple[int, dict[str, Any]]], float]:
        runs: list[tuple[int, dict[str, Any]]] = []
        for number, (step, result) in enumerate(zip(steps, (first, then), strict=True), 1):
            run = RunFolder.create(
                Path(config.cell.state_dir) / "runs", step.job, number, {}, MonotonicClock()
            )
            ended = "complete" if result["verdict"] else "stopped"
            if result["verdict"]:
                run.write_result(whole(result))
            run.finish({"outcome": ended, "packml": ended.upper(), "verdict": None, "error": None})
            runs.append((number, TRUTH))
        return runs, 1.0

    monkeypatch.setattr("daemon.rehearsal.play.run_objects", played)
    path = whole_example(tmp_path)
    return rehearse(load_config(path), path, "belt-tracking", 1, tmp_path)


def test_what_was_played_before_is_told_with_its_verdict(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    subject = picking(tmp_path, monkeypatch, "pass")
    assert subject.as_dict()["before"] == {"belt-calibration": "pass"}
    lines = list(outcome_lines("belt-tracking", subject))
    assert lines[1] == "  played before it: belt-calibration (pass), and this run goes by its result"


@pytest.mark.parametrize(("verdict", "told"), [("warn", "warn"), (None, "stopped")])
def test_a_run_is_not_said_to_go_by_a_result_that_is_not_in_effect(
    verdict: str | None, told: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lines = list(outcome_lines("belt-tracking", picking(tmp_path, monkeypatch, verdict)))
    assert lines[1] == f"  played before it: belt-calibration ({told})"


def test_a_run_that_was_not_started_goes_by_nothing() -> None:
    run = RehearsedRun(1, NOT_STARTED, 1.0, before={"cone-capture": "pass"}, why=["no arm"])
    assert list(outcome_lines("touch-test", run))[1] == "  played before it: cone-capture (pass)"


def test_a_warning_that_is_no_reason_is_told_once_and_so_is_what_the_limits_do_not_cover(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    subject = picking(tmp_path, monkeypatch, "pass")
    assert (subject.why, subject.warnings) == ([MISSED["text"]], [DELAYS["text"]])
    lines = list(outcome_lines("belt-tracking", subject))
    assert [line for line in lines if "missed" in line] == [f"  {MISSED['text']}"]
    assert [line for line in lines if "0.370" in line] == [f"  warning: {DELAYS['text']}"]
    assert any("within 1.000 mm (95 %, not all covered)" in line for line in lines)
    assert list(twin_lines([subject, subject])) == [
        "not covered by the stated 95 %: the camera's pose",
        "not covered by the stated 95 %: a slope",
    ]


def test_a_refused_rehearsal_leaves_no_folder_and_keeps_one_that_was_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    cellward, out = CommandLine(monkeypatch, capsys, whole_example(tmp_path)), tmp_path / "out"
    words = ("rehearse", "cone-capture", "--tool", "none", "--out", str(out))
    assert cellward(*words).code == 2
    assert not out.exists()
    out.mkdir()
    assert cellward(*words).code == 2
    assert (out.exists(), list(out.iterdir())) == (True, [])


def test_each_line_of_what_is_expected_says_what_it_is() -> None:
    run = RehearsedRun(1, "complete", 1.0, "pass", good=None, expected="14 arrivals\nnot in it: the floor")
    lines = list(outcome_lines("iso9283", run))
    assert "  expected of the cell: 14 arrivals" in lines
    assert "  expected of the cell: not in it: the floor" in lines
