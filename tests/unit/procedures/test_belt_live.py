"""What a live plot of a belt is drawn from, on virtual time, and its page."""

from typing import Any

import numpy as np
import pytest

from cell.traces import Trace
from daemon.status import LIVE_ROWS
from fakes.object import run_virtual
from procedures.belt.live import AHEAD_S, COLUMNS
from procedures.belt.live_words import live_line
from procedures.belt.motion.picker import LEARN_S
from procedures.belt.motion.tool_path import STEP_S
from procedures.belt.report.live import live_page
from tests.kit.object_cell import ObjectCell, no_report
from tests.kit.picking_cell import picking_cell, picking_config
from tests.unit.procedures.test_report_page import Page

__all__ = ["no_report"]
SPEED = 0.1537  # m/s; no whole number of counts a decision


def test_a_reader_gets_every_row_once_and_in_order_however_small_its_portions() -> None:
    subject, got, number = Trace(("t_s",)), [], 0
    for k in range(10):
        subject.add(float(k))
        number, rows = subject.since(number, 3)
        got += [row[0] for row in rows]
    assert got == [float(k) for k in range(10)]
    assert subject.since(number, 3) == (10, [])


def test_a_reader_that_is_too_slow_goes_on_with_the_oldest_row_there_is() -> None:
    subject = Trace(("t_s",), most=4)
    for k in range(10):
        subject.add(float(k))
    assert subject.since(2, 2) == (8, [(6.0,), (7.0,)])
    assert subject.since(8, 9) == (10, [(8.0,), (9.0,)])
    assert subject.since(99, 9) == (10, [])  # of another run


def all_rows(cell: ObjectCell) -> dict[str, list[Any]]:
    """As the command line reads them."""
    since: dict[str, int] = {}
    found: dict[str, list[Any]] = {name: [] for name in COLUMNS}
    while True:
        answer = cell.engine.live(since)
        fresh = {name: trace["rows"] for name, trace in answer["traces"].items()}
        assert all(len(rows) <= LIVE_ROWS for rows in fresh.values())
        if not any(fresh.values()):
            return found
        for name, trace in answer["traces"].items():
            found[name] += fresh[name]
            since[name] = trace["next"]


@pytest.fixture(scope="module")
def seen(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Rows of 8 s of picking, the truth beside them, and the numbers of now."""
    found: dict[str, Any] = {}

    async def scene() -> None:
        world = {"profile": f"[{{ speed_m_s = {SPEED} }}]"}
        async with picking_cell(picking_config(tmp_path_factory.mktemp("live"), world=world)) as cell:
            assert cell.engine.live({})["job"] is None
            run_id = await cell.start()
            await cell.clock.sleep(8.0)
            found["rows"], found["numbers"] = all_rows(cell), cell.engine.live({})["live"]
            found["belt"], found["run"] = cell.plant.world.belt, cell.engine.live({})["run_id"]
            assert found["run"] == run_id
            await cell.engine.abort("test")
            await cell.finished(run_id)

    run_virtual(scene())
    return found


def test_counts_and_what_is_made_of_them_are_beside_the_truth(seen: dict[str, Any]) -> None:
    t, raw, raw_speed, travel, speed = np.array(seen["rows"]["belt"])[50:].T
    assert t[-1] - t[0] > 5.0
    assert np.diff(t).max() < LEARN_S + STEP_S  # none is left out
    assert np.all(np.diff(t) > 0.0)
    moved = np.array([seen["belt"].travel_at(k) for k in t])
    count = seen["belt"].truth.m_per_count
    assert np.ptp(raw - moved) < 1.5 * count
    assert np.std(travel - moved) < 0.5 * np.std(raw - moved)
    assert np.std(raw_speed) > 10.0 * np.std(speed)
    assert speed == pytest.approx(SPEED, abs=0.001)


def test_items_are_where_they_were_expected_before(seen: dict[str, Any]) -> None:
    rows = np.array(seen["rows"]["items"])
    compared = 0
    for number in np.unique(rows[:, 1]):
        own = rows[rows[:, 1] == number]
        late = own[own[:, 0] > own[0, 0] + AHEAD_S]
        then = np.interp(late[:, 0], own[:, 0] + AHEAD_S, own[:, 4])
        assert then == pytest.approx(late[:, 2], abs=2e-3)
        compared += len(late)
    assert compared > 20


def test_one_line_tells_belt_items_picks_and_causes(seen: dict[str, Any]) -> None:
    line = live_line({**seen["numbers"], "misses": 3.0, "missed_out_of_zone": 3.0}, seen["rows"])
    assert "belt 0.15" in line
    assert "item" in line
    assert "picked, 3 missed (3 out of zone)" in line
    assert live_line({}, {}) == "nothing yet"


def test_the_page_draws_all_three_and_reads_itself_again(
    seen: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("procedures.belt.report.live.plotly_script", lambda: "")
    page = Page(live_page("run <7>", seen["rows"], 4.0))
    drawn = {attributes.get("id") for tag, attributes in page.elements if tag == "div"}
    assert {"speed", "beside", "items"} <= drawn
    assert [
        a["content"] for tag, a in page.elements if tag == "meta" and a.get("http-equiv") == "refresh"
    ] == ["4"]
    assert "No counts yet" in live_page("run 7", {}, None)
    assert "refresh" not in live_page("run 7", {}, None)
