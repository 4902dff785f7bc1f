"""``cellward live`` against a stand-in engine on a real control socket."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from daemon.cli import live
from tests.kit.cli_harness import CellOnDisk, CommandLine
from tests.kit.control_harness import RecordingEngine, served

PORTION = 7


class PickingEngine(RecordingEngine):
    """Its run leaves a row for each time that it is asked, after a first lot; ends after ``looks``."""

    def __init__(self, looks: int = 10**6, job: str | None = "belt-tracking") -> None:
        super().__init__()
        self.looks, self.job, self.sinces = looks, job, list[dict[str, int]]()

    def live(self, since: Mapping[str, int]) -> dict[str, Any]:
        self.sinces.append(dict(since))
        self.looks -= 1
        if self.looks < 0 or self.job is None:
            return {"run_id": None, "job": None, "state": None, "live": {}, "traces": {}}
        first = since.get("belt", 0)
        end = min(first + PORTION, 20)
        rows = [[0.02 * k, 0.003 * k, 0.15, 0.003 * k, 0.15] for k in range(first, end)]
        columns = ["t_s", "raw_m", "raw_m_s", "travel_m", "speed_m_s"]
        return {
            "run_id": 7, "job": self.job, "state": "wait", "live": {"picks": 5, "misses": 0},
            "traces": {"belt": {"columns": columns, "next": end, "rows": rows}},
        }  # fmt: skip


@pytest.fixture
def subject(
    cell: CellOnDisk, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> CommandLine:
    monkeypatch.setattr(live, "LOOK_S", 0.01)
    monkeypatch.setattr("procedures.belt.report.live.plotly_script", lambda: "")
    return CommandLine(monkeypatch, capsys, cell.config)


def test_it_tells_the_belt_and_the_picks_until_its_time_is_over(
    cell: CellOnDisk, subject: CommandLine
) -> None:
    with served(cell.socket, PickingEngine()):
        done = subject("live", "--for", 0.05)
    assert done.code == 0
    assert "belt 0.1500 m/s" in done.out
    assert "5 picked" in done.out


def test_for_programs_each_row_comes_once_however_small_the_portions(
    cell: CellOnDisk, subject: CommandLine
) -> None:
    with served(cell.socket, PickingEngine(looks=8)):
        done = subject("live", "--json")
    assert done.code == 0
    rows = [row for line in done.out.splitlines() if "trace" in (row := json.loads(line))]
    assert [row["t_s"] for row in rows] == pytest.approx([0.02 * k for k in range(20)])
    assert "has ended" in done.err


def test_a_page_is_drawn_while_it_runs_and_reads_itself_no_more_at_the_end(
    cell: CellOnDisk, subject: CommandLine, tmp_path: Path
) -> None:
    page = tmp_path / "belt.html"
    with served(cell.socket, PickingEngine(looks=8)):
        assert subject("live", "--plot", page).code == 0
    assert "belt-tracking, run 7" in page.read_text("utf-8")
    assert 'http-equiv="refresh"' not in page.read_text("utf-8")
    assert [path.name for path in tmp_path.glob("*.tmp")] == []


def test_without_a_job_it_says_so(cell: CellOnDisk, subject: CommandLine) -> None:
    with served(cell.socket, PickingEngine(job=None)):
        done = subject("live")
    assert done.code == 4
    assert "no job runs" in done.err


def test_a_page_that_cannot_be_written_is_bad_input(
    cell: CellOnDisk, subject: CommandLine, tmp_path: Path
) -> None:
    with served(cell.socket, PickingEngine()):
        done = subject("live", "--plot", tmp_path / "none" / "belt.html")
    assert done.code == 2
    assert "belt.html cannot be written" in done.err
