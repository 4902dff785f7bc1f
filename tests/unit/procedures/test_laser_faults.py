"""What goes wrong at the beams: the right error, by the beam's name, with the arm at rest."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cell.interruptions import InterruptionLimits
from fakes.object import run_virtual
from tests.kit.ideal_world import ideal_text
from tests.kit.laser_cell import laser_cell, laser_config, passes
from tests.kit.laser_made import Solved, solved
from tests.kit.object_cell import ObjectCell, no_report

__all__ = ["no_report", "solved"]
pytestmark = pytest.mark.usefixtures("no_report")

JOB = "laser-reference"


def run_with(tmp_path: Path, prepare: Any, **sections: Any) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Run the job after ``prepare(cell)``; its end, and the ways it took."""
    out: list[Any] = []

    async def main() -> None:
        async with laser_cell(laser_config(tmp_path, **sections), JOB) as cell:
            prepare(cell)
            end = await cell.run_job()
            assert cell.at_rest()
            assert (end["outcome"], end["packml"]) == ("aborted", "ABORTED")
            assert cell.ledger.results() == []
            out.extend((end["error"], passes(cell, 1)))

    run_virtual(main())
    return out[0], out[1]


def bend(*shift_m: float) -> Any:
    return lambda cell: cell.plant.world.tool.bend(cell.clock.now(), shift_m)


def beams_fault(kind: str, **arguments: Any) -> Any:
    return lambda cell: cell.plant.inputs.inject(kind, arguments)


def at(state: str, act: Any, after_s: float = 0.0, times: int = 1) -> Any:
    """Do ``act(cell)`` when the job enters ``state``."""
    return lambda cell: cell.at_state(state, lambda: act(cell), after_s, times)


def test_a_tool_too_short_was_searched_for_in_both_beams_down_to_the_limit(tmp_path: Path) -> None:
    error, ways = run_with(tmp_path, bend(0.0, 0.0, -0.05))
    assert error["name"] == "LASER_TOOL_NOT_FOUND"
    assert "beam xs" in error["text"]
    assert "beam ys" in error["text"]
    assert "258.0 mm down to 242.0 mm" in error["text"]
    assert {w["beam"] for w in ways} == {"xs", "ys"}
    assert not any(any(w["poll_v"]) for w in ways)


def test_the_floor_ends_a_search_before_its_count_does(tmp_path: Path) -> None:
    floor = {"max_descents": 100, "floor_m": 0.225, "descend_step_m": 0.005}
    error, ways = run_with(tmp_path, bend(0.0, 0.0, -0.05), reference=floor)
    assert error["name"] == "LASER_TOOL_NOT_FOUND"
    lowest = min(w["z"] for w in ways) - 0.18
    assert lowest == pytest.approx(0.233, abs=1e-4), "room to measure 6 mm below is left above the floor"


def test_a_tool_too_long_is_met_at_once_and_not_lowered(tmp_path: Path) -> None:
    error, ways = run_with(tmp_path, bend(0.0, 0.0, 0.04))
    assert error["name"] == "LASER_TOOL_TOO_LONG"
    assert "beam xs" in error["text"]
    assert min(w["z"] for w in ways) == pytest.approx(0.258 + 0.18, abs=1e-4)


def test_a_tool_that_stands_in_the_beam_at_the_auxiliary_point_is_too_long_or_bent(tmp_path: Path) -> None:
    error, ways = run_with(tmp_path, bend(0.0, -0.015, 0.02))
    assert error["name"] == "LASER_TOOL_TOO_LONG"
    assert "at the auxiliary point" in error["text"]
    assert ways == []


@pytest.mark.parametrize("beam", ["xs", "ys"])
def test_a_beam_stuck_dark_is_named_before_anything_moves(beam: str, tmp_path: Path) -> None:
    error, ways = run_with(tmp_path, beams_fault("stuck", input=beam, level="on"))
    assert error["name"] == "LASER_BEAM_DARK"
    assert f"beam {beam} is broken before anything moved" in error["text"]
    assert ways == []


def test_a_beam_that_sticks_dark_in_a_sweep_is_named_after_the_retries(tmp_path: Path) -> None:
    def stick(cell: ObjectCell) -> None:
        cell.plant.inputs.inject("stuck", {"input": "xs", "level": "on"})

    error, ways = run_with(tmp_path, at("return", stick), reference={"retries": 1})
    assert error["name"] == "LASER_BEAM_DARK"
    assert "with the tool beside it, in 2 attempts" in error["text"]
    assert [w["used"] for w in ways] == [False] * 4


@pytest.mark.parametrize("beam", ["xs", "ys"])
def test_a_beam_that_never_switches_is_told_from_a_missing_tool_by_the_other(
    beam: str, tmp_path: Path
) -> None:
    error, _ = run_with(tmp_path, beams_fault("stuck", input=beam, level="off"))
    assert error["name"] == "LASER_BEAM_STUCK"
    other = "ys" if beam == "xs" else "xs"
    assert f"beam {beam}, place 1 was not met" in error["text"]
    assert f"while beam {other} was" in error["text"]


def test_a_module_that_reboots_in_mid_pass_costs_that_pass_and_not_the_run(tmp_path: Path) -> None:
    async def main() -> None:
        async with laser_cell(laser_config(tmp_path), JOB) as cell:
            at("bisect", beams_fault("reboot"), 0.1)(cell)
            end = await cell.run_job()
            assert end["outcome"] == "complete", end["error"]
            (again,) = cell.result(1)["inputs"]["steps_taken_again"]
            assert again["cause"] == "DEVICE_LOST"

    run_virtual(main())


def test_a_module_that_stays_silent_ends_the_job(tmp_path: Path) -> None:
    error, ways = run_with(tmp_path, at("bisect", beams_fault("silence"), 0.1))
    assert error["name"] in ("DEVICE_LOST", "STALE_DATA")
    assert ways, "what was on disk stays there"


def deaf_on_return(cell: ObjectCell) -> None:
    """From now on the beams switch on the way out only."""
    inputs = cell.plant.inputs
    cell.at_state("return", lambda: inputs.inject("stuck", {"level": "off"}), times=1000)
    cell.at_state("sweep", inputs.clear, times=1000)


def test_a_trigger_on_the_way_out_alone_ends_no_search_until_it_was_too_often(tmp_path: Path) -> None:
    error, ways = run_with(
        tmp_path, deaf_on_return, reference={"descend_step_m": 0.004, "max_descents": 9, "retries": 2}
    )
    assert error["name"] == "LASER_RETURN_LOST"
    assert "switched on the way out and not on the way back" in error["text"]
    alone = [w for w in ways if w["dir"] == 1 and any(w["poll_v"])]
    assert len({w["z"] for w in alone}) == 3, "each time a step lower"
    assert all(w["used"] for w in alone), "it tells the height all the same"


def test_gaps_between_polls_end_the_job_when_they_go_on(tmp_path: Path) -> None:
    def gap(cell: ObjectCell) -> None:
        cell.plant.inputs.inject("gap", {"count": 12})

    error, ways = run_with(tmp_path, at("sweep", gap, 0.05, times=100), reference={"retries": 2})
    assert error["name"] == "LASER_POLL_GAP"
    assert "in 3 attempts" in error["text"]
    assert [w["used"] for w in ways] == [False] * 6 * InterruptionLimits().in_a_row


def test_one_gap_is_only_a_pass_again(tmp_path: Path, solved: Solved) -> None:
    async def main() -> None:
        async with laser_cell(laser_config(tmp_path), JOB) as cell:
            cell.at_state("sweep", lambda: cell.plant.inputs.inject("gap", {"count": 12}), 0.05)
            end = await cell.run_job()
            assert end["outcome"] == "complete", end["error"]
            again = [w for w in passes(cell, 1) if not w["used"] and w["notes"]["phase"] == "search"]
            assert len(again) == 2
            assert all("no poll of the inputs for" in w["why"] for w in again)

    run_virtual(main())


def test_a_speed_that_changes_between_the_edges_is_no_measurement(tmp_path: Path) -> None:
    slow = {"lead_m": 0.0005, "measure_speed_m_s": 0.25, "retries": 1, "max_speed_deviation": 0.02}
    limits = {**laser_config(tmp_path).limits.model_dump(), "accel_m_s2": 2.0}
    error, _ = run_with(tmp_path, lambda cell: None, reference=slow, limits=limits)
    assert error["name"] == "LASER_SPEED"
    assert "beam xs" in error["text"]
    assert "the limit is 2 %" in error["text"]


def test_out_and_back_that_disagree_point_to_the_delay(tmp_path: Path) -> None:
    error, _ = run_with(tmp_path, lambda cell: None, reference={"max_out_back_m": 0.0001, "retries": 1})
    assert error["name"] == "LASER_OUT_BACK"
    assert "latency-calibration" in error["hint"]


def test_more_edges_than_a_tool_makes_are_named(tmp_path: Path) -> None:
    error, _ = run_with(tmp_path, lambda cell: None, reference={"edges": 4, "retries": 0})
    assert error["name"] == "LASER_EDGES"
    assert "beam xs switched 2 times, not 4" in error["text"]


def two_fingers(folder: Path) -> str:
    """The cell with beams, and two pins instead of one, 12 mm apart along x and along y."""
    text = ideal_text("laser")
    pins = [
        f"{{ from = [{x}, {x}, -0.003], to = [{x}, {x}, -0.057], radius_m = 0.003 }}" for x in (-0.006, 0.006)
    ]
    changed, count = re.subn(r"^shape = .*$", f"shape = [{', '.join(pins)}]", text, flags=re.MULTILINE)
    assert count == 1
    path = folder / "fingers.toml"
    path.write_text(changed, "utf-8")
    return str(path)


def test_a_gripper_with_two_fingers_is_measured_by_four_edges(tmp_path: Path, solved: Solved) -> None:
    config = laser_config(tmp_path, reference={"edges": 4}, scenario=two_fingers(tmp_path))

    async def main() -> None:
        async with laser_cell(config, JOB) as cell:
            assert (await cell.run_job())["outcome"] == "complete"
            measured = [w for w in passes(cell, 1) if w["notes"]["phase"] == "measure"]
            assert len(measured) == 2 * 2 * 2, "out and back at two places of two beams"
            for way in measured:
                assert way["used"]
                assert np.count_nonzero(np.diff(way["poll_v"])) == 4

    run_virtual(main())


def test_contacts_that_bounce_are_no_further_edges(tmp_path: Path, solved: Solved) -> None:
    async def main() -> None:
        async with laser_cell(laser_config(tmp_path), JOB) as cell:
            cell.plant.inputs.inject("bounce", {"s": 0.002})
            assert (await cell.run_job())["outcome"] == "complete"
            measured = [w for w in passes(cell, 1) if w["notes"]["phase"] == "measure"]
            assert all(w["used"] for w in measured)
            assert max(w["poll_n"][-1] - w["poll_n"][0] for w in measured) > 2, "it did bounce"

    run_virtual(main())
