"""The report of an aborted run: its first page says NO-GO and why, and it tells how timely data were."""

import json
from pathlib import Path

import pytest

from cell.clock import MonotonicClock
from cell.errors import error
from cell.store.runs import RunFolder
from procedures.report.failed import write_failed_report
from tests.unit.procedures.test_report_page import Page

NOT_TIMELY = {"n": 269, "p50_s": 0.001, "p99_s": 0.0106, "p999_s": 0.0168, "max_s": 0.1368}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    info = {
        "parameters": {},
        "config": {"cell": {"name": "bay-3", "twin": False}, "device": {"arm": {"calibrated": "2026-05-31"}}},
        "identities": {"arm": {"model": "ur10e", "serial": "20195501234"}},
        "started_by": {"who": "anna", "channel": "web"},
    }
    run = RunFolder.create(tmp_path, "laser-check", 3, info, MonotonicClock())
    run.note("state", state="sweep", why="")
    run.note("motion", event="move_linear", to="beam xs")
    run.note("device", event="timing", loop_lag={"n": 0}, state_age=NOT_TIMELY)
    failure = error("DEVICE_LOST", "arm: newest sample is 0.136 s old").as_dict()
    run.finish({"outcome": "aborted", "packml": "ABORTED", "verdict": None, "error": failure})
    return run.path


def test_the_first_page_says_no_go_and_names_the_cause(folder: Path) -> None:
    text = Page(write_failed_report(folder).read_text("utf-8")).text
    assert "NO-GO the run ended aborted: " in text
    assert text.index("newest sample is 0.136 s old") < text.index("Signatures")
    assert "started by anna over web" in text
    assert "arm ur10e 20195501234 2026-05-31" in text
    assert "Simulated" not in text


def test_it_tells_the_last_entries_with_the_moves_and_how_old_the_states_were(folder: Path) -> None:
    text = Page(write_failed_report(folder).read_text("utf-8")).text
    assert "motion move_linear" in text
    assert "the arm's states were old by 10.6 ms 136.8 ms" in text
    assert "the event loop woke late" not in text  # it was not measured


LAST = {
    "schema": "cellward.last-seconds/1",
    "devices": {
        "arm": {"columns": [["joint 1", "rad"], ["speed of joint 1", "rad/s"]], "rows": [[-0.5, 1.0, 0.5]]},
        "beams": {"columns": [["xs", ""], ["ys", ""]], "rows": [[-0.02, 0, 1], [-0.01, 1, 1]]},
    },
}


def test_it_draws_the_last_seconds_of_the_devices(folder: Path) -> None:
    (folder / "last_seconds.json").write_text(json.dumps(LAST), "utf-8")
    html = write_failed_report(folder).read_text("utf-8")
    assert "The last seconds" in Page(html).text
    for drawn in ("arm, deg\\u002fs", "speed of joint 1", "28.64", "beams", "last-beams-0"):
        assert drawn in html, drawn
    assert "last-arm-1" not in html  # where the joint stood is not drawn


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"devices": {"arm": {"columns": 3, "rows": [[1]]}}}'])
def test_last_seconds_that_cannot_be_read_cost_no_report(folder: Path, text: str) -> None:
    (folder / "last_seconds.json").write_text(text, "utf-8")
    told = Page(write_failed_report(folder).read_text("utf-8")).text
    assert "last_seconds.json cannot be read" in told
    assert "newest sample is 0.136 s old" in told


def test_a_run_that_somebody_stopped_says_who_did(tmp_path: Path) -> None:
    run = RunFolder.create(tmp_path, "laser-check", 4, {"parameters": {}}, MonotonicClock())
    run.note("state", state="sweep", why="")
    run.note("operator", event="halt", who="ida (page, 127.0.0.1)")
    run.finish({"outcome": "halted", "packml": "ABORTED", "verdict": None, "error": None})
    text = Page(write_failed_report(run.path).read_text("utf-8")).text
    assert "NO-GO the run ended halted: stopped at once by ida (page, 127.0.0.1)." in text
    assert "The run was stopped at once by ida (page, 127.0.0.1)." in text
    assert "The job was in the state sweep. The cell ended in ABORTED." in text


def test_the_last_entries_of_a_long_run_keep_their_time_in_it(tmp_path: Path) -> None:
    run = RunFolder.create(tmp_path, "laser-check", 4, {}, Ticking())
    for number in range(60):
        run.note("state", state=f"step {number}", why="")
    run.finish({"outcome": "aborted", "packml": "ABORTED", "verdict": None, "error": None})
    text = Page(write_failed_report(run.path).read_text("utf-8")).text
    assert "The last 30 of 6" in text
    assert "60.0 state step 59" in text


class Ticking(MonotonicClock):
    """A second later at each look."""

    def __init__(self) -> None:
        self._now = 100.0

    def now(self) -> float:
        self._now += 1.0
        return self._now
