"""The ledger keeps a summary of a result; whoever needs the whole reads the run folder."""

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from cell.errors import CellError
from cell.store.ledger import Ledger
from cell.store.summary import LEFT_OUT, summary, whole_result
from daemon.cli.export_source import from_file
from tests.kit.cli_harness import CellOnDisk, CommandLine, hand_eye_result

NAME = "T_flange_camera"


def large_result() -> dict[str, Any]:
    """A hand-eye result with ten thousand residuals."""
    result = hand_eye_result()
    result["residuals"]["per_pose"] = [0.1 * i for i in range(10_000)]
    result["heldout"] = {str(i): [i, i] for i in range(500)}
    return result


def test_a_summary_has_what_a_decision_and_an_export_need_and_names_the_rest() -> None:
    result = large_result()
    subject = summary(result)
    assert subject[LEFT_OUT] == ["residuals.per_pose", "heldout"]
    assert subject["residuals"] == {k: v for k, v in result["residuals"].items() if k != "per_pose"}
    assert "heldout" not in subject
    assert subject["result"] == result["result"]
    assert subject["warnings"] == result["warnings"]
    assert len(json.dumps(subject)) < 4000


def test_what_jobs_go_by_is_kept_however_long() -> None:
    result = large_result()
    result["result"]["lens_cov"] = [[0.1 / (i + k + 3) for k in range(14)] for i in range(14)]
    assert summary(result)["result"] == result["result"]


def test_warnings_are_kept_however_many_there_are() -> None:
    result = hand_eye_result() | {"warnings": [{"code": "x", "text": "y" * 100}] * 100}
    assert summary(result) == result


@pytest.fixture
def cell(tmp_path: Path) -> CellOnDisk:
    """A cell whose ledger has one committed result of run 1."""
    cell = CellOnDisk(tmp_path)
    run = cell.add_run(1, large_result(), outcome="complete", verdict="pass")
    ledger = Ledger(cell.state / "ledger.sqlite")
    value = large_result()["result"][NAME]
    ledger.accept(ledger.propose(NAME, value, large_result(), 1, None, folder=run.path.name), "anna")
    ledger.close()
    return cell


@pytest.fixture
def subject(
    cell: CellOnDisk, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> CommandLine:
    return CommandLine(monkeypatch, capsys, cell.config)


def test_the_whole_result_comes_from_the_run_folder(cell: CellOnDisk, subject: CommandLine) -> None:
    ledger = Ledger(cell.state / "ledger.sqlite", read_only=True)
    row = ledger.result(1)
    ledger.close()
    assert row["result"][LEFT_OUT]
    assert whole_result(row, cell.state / "runs") == large_result()
    (shown,) = json.loads(subject("results", 1, "--json").out)
    assert shown["result"] == large_result()


def test_an_export_of_a_version_that_came_back_from_the_copy_has_its_uncertainty(
    cell: CellOnDisk, subject: CommandLine
) -> None:
    before = json.loads(subject("export", NAME, "--format", "json").out)
    assert before["uncertainty"]["sigma_m"][0] > 0
    path = cell.state / "ledger.sqlite"
    path.write_bytes(b"\xff" * 20_000)
    Ledger(path).close()
    after = json.loads(subject("export", NAME, "--format", "json").out)
    assert after == before


def test_an_export_whose_run_folder_is_gone_says_what_is_unknown(
    cell: CellOnDisk, subject: CommandLine
) -> None:
    path = cell.state / "ledger.sqlite"
    path.write_bytes(b"\xff" * 20_000)
    Ledger(path).close()
    shutil.rmtree(cell.state / "runs")
    assert "the folder of run 1 is gone" in subject("export", NAME, "--format", "json").out


def test_what_was_altered_after_its_run_is_not_its_result_any_more(cell: CellOnDisk, tmp_path: Path) -> None:
    (folder,) = (cell.state / "runs").iterdir()
    ledger = Ledger(cell.state / "ledger.sqlite", read_only=True)
    row = ledger.result(1)
    ledger.close()
    assert whole_result(row, cell.state / "runs") is not None
    path = folder / "result.json"
    path.write_text(path.read_text("utf-8").replace('"verdict": "pass"', '"verdict": "warn"'), "utf-8")
    assert whole_result(row, cell.state / "runs") is None
    with pytest.raises(CellError, match="altered after the end of its run"):
        from_file(folder)
