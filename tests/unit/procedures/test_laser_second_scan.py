"""The scan with the candidate: what confirms it, and which tool the controller holds afterwards."""

from pathlib import Path

import pytest

from cell.poses import to_pose6
from fakes.object import run_virtual
from tests.kit.laser_cell import (
    laser_cell,
    laser_config,
    states_of_results,
)
from tests.kit.laser_made import T_TOOL, Solved, drawn_reference, solved
from tests.kit.laser_runs import AUTO, JOB, replayed
from tests.kit.object_cell import ObjectCell, no_report

__all__ = ["no_report", "solved"]

pytestmark = pytest.mark.usefixtures("no_report")


def tcp_of(cell: ObjectCell) -> list[float]:
    """The TCP that the controller holds."""
    return [float(v) for v in to_pose6(cell.plant.controller.T_flange_tcp)]


@pytest.mark.parametrize("meets", [True, False])
def test_the_controller_gets_the_tool_in_effect_back_when_the_second_scan_is_over(
    meets: bool, tmp_path: Path, solved: Solved
) -> None:
    solved.meets = meets
    config = laser_config(tmp_path, update=AUTO)

    async def main() -> None:
        async with laser_cell(config, JOB, drawn_reference(config)) as cell:
            tried: list[list[float]] = []
            cell.at_state("retract", lambda: tried.append(tcp_of(cell)), times=2)
            end = await cell.run_job()
            assert end["verdict"] == ("pass" if meets else "fail")
            first, second = tried
            assert first == pytest.approx(T_TOOL, abs=1e-9)
            assert second == pytest.approx([0.001, -0.0007, *T_TOOL[2:]], abs=1e-9), "the candidate"
            assert tcp_of(cell) == pytest.approx(T_TOOL, abs=1e-9)
            assert cell.result(1)["inputs"]["update"]["controller_tool"] == "in effect"
            assert [n["done"] for n in cell.notes(1, "tool given back")] == [True]

    run_virtual(main())


def test_a_controller_that_cannot_take_the_tool_back_is_said_to_hold_the_candidate(
    tmp_path: Path, solved: Solved
) -> None:
    config = laser_config(tmp_path, update=AUTO)

    async def main() -> None:
        async with laser_cell(config, JOB, drawn_reference(config)) as cell:

            def stop_the_second_scan() -> None:
                if len(cell.notes(1, "lease")) == 2:
                    cell.plant.controller.inject("protective-stop")

            cell.at_state("return", stop_the_second_scan, times=1000)
            end = await cell.run_job()
            assert end["error"]["name"] == "ARM_PROTECTIVE_STOP"
            assert states_of_results(cell) == ["rejected"]
            assert tcp_of(cell)[0] == pytest.approx(0.001, abs=1e-9)
            (note,) = cell.notes(1, "tool given back")
            assert not note["done"]
            assert note["controller_tcp"] == pytest.approx(tcp_of(cell), abs=1e-9)

    run_virtual(main())


def test_a_second_scan_that_says_little_confirms_nothing(tmp_path: Path, solved: Solved) -> None:
    config = laser_config(tmp_path, update=AUTO)
    solved.U_second = 0.05

    async def main() -> None:
        async with laser_cell(config, JOB, drawn_reference(config)) as cell:
            end = await cell.run_job()
            assert (end["outcome"], end["verdict"]) == ("complete", "fail")
            assert "max_U_m" in cell.result(1)["reasons"][0]
            assert states_of_results(cell) == ["rejected"]
            assert replayed(cell, 1) == []

    run_virtual(main())


@pytest.mark.parametrize(
    ("misses", "scans", "outcome"),
    [
        ([1.5, 0.8], 2, "committed"),
        ([1.5, 1.2], 2, "rejected"),
        ([2.1], 1, "rejected"),
        ([0.9], 1, "committed"),
    ],
)
def test_a_second_scan_that_missed_narrowly_is_taken_once_more_and_both_decide(
    tmp_path: Path, solved: Solved, misses: list[float], scans: int, outcome: str
) -> None:
    config = laser_config(tmp_path, update=AUTO)
    solved.misses = misses

    async def main() -> None:
        async with laser_cell(config, JOB, drawn_reference(config)) as cell:
            await cell.run_job()
            assert states_of_results(cell) == [outcome]
            assert cell.result(1)["inputs"]["update"]["second_scan"]["scans"] == scans
            assert (cell.folder(1).path / "third").exists() == (scans == 2)
            if outcome == "rejected":
                words = "second and third scan" if scans == 2 else "second scan"
                assert f"not confirmed: {words}: the tool's point is" in cell.result(1)["reasons"][0]
                assert "in 1 of 300" in cell.result(1)["reasons"][0]
            assert cell.at_rest()
            assert replayed(cell, 1) == []

    run_virtual(main())
