"""From a bent tool to a committed tool frame, and every way in which a candidate is turned down instead."""

import asyncio
import shutil
from pathlib import Path

import numpy as np
import pytest

from cell.calibrations import laser_reference, tool_calibration
from cell.errors import error
from cell.poses import from_pose6
from daemon.predictions import predictions
from fakes.object import VirtualClock, run_virtual
from tests.kit.laser_cell import (
    TOOL,
    committed_tool,
    laser_cell,
    laser_config,
    point_of,
    states_of_results,
    the_plain_rule_misses,
    true_axis,
    true_point,
)
from tests.kit.laser_made import Solved, drawn_reference, solved
from tests.kit.laser_runs import AUTO, JOB, asked, replayed
from tests.kit.object_cell import WHO, ObjectCell, no_report, on_disk, refused

__all__ = ["no_report", "solved"]

pytestmark = pytest.mark.usefixtures("no_report")


BEND = ([0.0012, -0.0007, 0.0005], [0.006, -0.008, 0.0])  # 1.48 mm, 10 mrad
FINE = {
    "search_speed_m_s": 0.3,
    "measure_speed_m_s": 0.05,
    "passes": 2,
    "z_resolution_m": 0.0001,
    "lead_m": 0.003,
    "settle_s": 0.0,
}


def bent(cell: ObjectCell) -> None:
    cell.plant.world.tool.bend(cell.clock.now(), *BEND)


def test_a_moved_tool_is_found_and_a_bent_one_measured_tried_and_written_within_its_uncertainty(
    tmp_path: Path,
) -> None:
    """One reference for the checks of a good tool and of a bumped one, and for the update of a bent one; what
    ``cellward check`` promised to find is no smaller than what the runs say."""
    config = laser_config(tmp_path, reference=FINE, update=AUTO, quick=False)

    async def main() -> None:
        async with laser_cell(config, "laser-reference") as cell:
            made = await cell.run_job()
            assert (made["outcome"], made["verdict"]) == ("complete", "pass"), made
            (row,) = cell.ledger.results(laser_reference(TOOL))
            await cell.engine.decisions.accept(row["id"], WHO)
            good = await cell.run_job(job="laser-check")
            assert (good["outcome"], good["verdict"]) == ("complete", "pass"), cell.result(2)["reasons"]
            cell.plant.world.tool.bend(cell.clock.now(), BEND[0], [0.0, 0.0, 0.0])
            found = await cell.run_job(job="laser-check")
            assert (found["outcome"], found["verdict"]) == ("complete", "fail")
            moved = cell.result(3)["result"]["moved"]
            assert moved["shift_m"] == pytest.approx(float(np.linalg.norm(BEND[0])), abs=moved["U_shift_m"])

            bent(cell)
            end = await cell.run_job(job=JOB)
            assert (end["outcome"], end["verdict"]) == ("complete", "pass"), cell.result(4)["reasons"]
            result = cell.result(4)
            committed = committed_tool(cell)
            assert committed == result["result"]["T_flange_tool"]
            U = result["uncertainty"]["U_point_m"]
            assert U < 0.0002
            assert float(np.linalg.norm(point_of(committed) - true_point(cell))) <= U
            axis = from_pose6(committed).rotation.apply([0.0, 0.0, 1.0])
            assert float(np.arccos(axis @ true_axis(cell))) <= result["uncertainty"]["U_tilt_rad"]
            second = result["inputs"]["update"]["second_scan"]
            assert second["meets"]
            assert second["apart"] <= second["U_m"]
            assert result["inputs"]["update"]["committed"]
            assert {"beams.latency_s.beams", f"tool.offset_x_m.{TOOL}"} <= set(result["inputs"]["trend"])
            assert cell.at_rest()
            after = await cell.run_job(job="laser-check")
            assert (after["outcome"], after["verdict"]) == ("complete", "pass"), cell.result(5)["reasons"]
            (promised,) = (one for one in predictions(config) if one["job"] == "laser-reference")
            found = [cell.result(run_id)["result"]["moved"]["detectable_m"] for run_id in (2, 5)]
            assert found[0] < found[1] <= promised["detectable_m"] < 2.0 * found[1]
            size = promised["second_scan"]["detectable_m"]
            assert second["detectable_m"] <= size < 2.0 * second["detectable_m"]
            assert replayed(cell, 1) == []
            the_plain_rule_misses(cell.folder(4).path, result["result"], row["value"], 2.0 * BEND[0][0])
            now = await cell.engine.decisions.rollback(tool_calibration(TOOL), WHO)
            assert now["version"] is None, "one step back is the configured tool"

    run_virtual(main())


def test_an_operator_is_shown_the_figures_and_a_confirm_accepts(tmp_path: Path, solved: Solved) -> None:
    config = laser_config(tmp_path)

    async def main() -> None:
        async with laser_cell(config, JOB, drawn_reference(config)) as cell:
            done = steps_done(cell)
            run_id = await cell.start()
            await cell.until_state("measure")
            assert cell.engine.status()["step"] > 0, "the search counts"
            await cell.until_state("ask")
            assert cell.at_rest()
            assert cell.engine.status()["packml"] == "HELD"
            assert done[-1] == 0.5, "another scan is to come"
            text = cell.engine.status()["prompt"]["text"]
            assert "moved by +1.000, -0.700, +0.000 mm in the flange" in text
            assert "the tilt was not measured (95 % uncertainty of the point 0.100 mm)" in text
            (row,) = cell.ledger.results(tool_calibration(TOOL))
            for outside in (
                cell.engine.decisions.accept(row["id"], WHO),
                cell.engine.decisions.reject(row["id"], WHO, "no"),
            ):
                assert (await refused(outside)).name == "NOT_NOW"
            end = await cell.finished(run_id)
            assert end["verdict"] == "pass"
            assert done == sorted(done)
            assert done[-1] == 1.0
            assert states_of_results(cell) == ["committed"]
            assert committed_tool(cell) == [0.001, -0.0007, 0.18, 0.0, 0.0, 0.0]
            assert cell.result(run_id)["inputs"]["update"]["accepted_by"] == "operator"
            assert replayed(cell, run_id) == []
            R = from_pose6([0.0, 0.0, 0.0, *drawn_reference(config)["R_base_flange"]])
            first, second = sweeps_of(cell, run_id)
            # The second scan goes to its own start first, then its point takes the way of the reference's.
            assert np.array(second[1]) - first[0] == pytest.approx(-R.apply(np.array(solved.dp)), abs=1e-9)

    run_virtual(main())


def steps_done(cell: ObjectCell) -> list[float]:
    """Which share of its steps the run has done, each time that something of the cell changes from now on."""
    shares: list[float] = []

    def look() -> None:
        status = cell.engine.status()
        if status["steps"]:
            shares.append(status["step"] / status["steps"])

    cell.engine.subscribe(look)
    return shares


def sweeps_of(cell: ObjectCell, run_id: int) -> list[list[list[float]]]:
    """Where the lines of each lease went."""
    leases: list[list[list[float]]] = []
    for line in cell.journal(run_id):
        if line.get("event") == "lease":
            leases.append([])
        elif line.get("event") == "move_linear":
            leases[-1].append(line["to"])
    return leases


def test_the_policy_does_not_accept_what_has_a_warning(tmp_path: Path, solved: Solved) -> None:
    solved.verdict = "warn"
    config = laser_config(tmp_path, update=AUTO)

    async def main() -> None:
        async with laser_cell(config, JOB, drawn_reference(config)) as cell:
            tasks = asked(cell, "ask", lambda: cell.engine.abort(WHO))
            await cell.run_job()
            await asyncio.wait(tasks)
            assert len(cell.notes(1, "prompt")) == 1
            assert states_of_results(cell) == ["rejected"]

    run_virtual(main())


@pytest.mark.parametrize(
    ("state", "verb", "outcome"),
    [
        ("ask", "finish", "complete"),
        ("ask", "halt", "halted"),
        ("verify", "finish", "complete"),
        ("verify", "abort", "stopped"),
        ("compare", "halt", "halted"),
    ],
)
def test_whatever_ends_the_run_before_the_point_is_confirmed_rejects_the_candidate(
    state: str, verb: str, outcome: str, tmp_path: Path, solved: Solved
) -> None:
    config = laser_config(tmp_path, update={} if state == "ask" else AUTO)

    async def main() -> None:
        async with laser_cell(config, JOB, drawn_reference(config)) as cell:
            tasks = asked(cell, state, lambda: getattr(cell.engine, verb)(WHO))
            run_id = await cell.start()
            while cell.engine.active:
                await cell.clock.sleep(0.05)
            await asyncio.wait(tasks)
            assert cell.end(run_id)["outcome"] == outcome
            assert states_of_results(cell) == ["rejected"]
            assert committed_tool(cell) is None
            assert cell.at_rest()
            (row,) = cell.ledger.results(tool_calibration(TOOL))
            assert row["why"]

    run_virtual(main())


@pytest.mark.parametrize(("state", "left"), [("measure", []), ("verify", ["rejected"])])
def test_a_run_folder_that_is_removed_is_not_made_again_and_nothing_is_committed(
    state: str, left: list[str], tmp_path: Path, solved: Solved
) -> None:
    config = laser_config(tmp_path, update=AUTO)

    async def main() -> None:
        async with laser_cell(config, JOB, drawn_reference(config)) as cell:
            await cell.start()
            await cell.until_state(state)
            shutil.rmtree(cell.runs)
            cell.runs.mkdir()
            await cell.until(lambda: not cell.engine.active, "the end")
            assert cell.engine.status()["error"]["name"] == "RUN_FOLDER_LOST"
            assert states_of_results(cell) == left
            assert committed_tool(cell) is None
            assert list(cell.runs.iterdir()) == []

    run_virtual(main())


def test_a_killed_run_leaves_a_candidate_that_the_next_start_rejects(tmp_path: Path, solved: Solved) -> None:
    clock = VirtualClock()
    config = laser_config(tmp_path, update=AUTO)

    async def main() -> None:
        cell = ObjectCell(config, clock, JOB)
        await cell.open()
        reference = cell.ledger.propose(laser_reference(TOOL), drawn_reference(config), {}, 0, None)
        on_disk(cell.ledger.accept, reference, WHO)
        await cell.start()
        await cell.until_state("verify")
        (row,) = cell.ledger.results(tool_calibration(TOOL))
        assert row["state"] == "accepted"
        cell.ledger.reject = lambda *_: row  # type: ignore[method-assign]  # a dead process writes nothing
        await cell.kill()
        async with laser_cell(config, JOB, clock=clock) as again:
            (row,) = again.ledger.results(tool_calibration(TOOL))
            assert (row["state"], row["who"]) == ("rejected", "daemon")
            assert "ended before it was confirmed" in row["why"]
            assert states_of_results(again, laser_reference(TOOL)) == []

    run_virtual(main())


def test_a_candidate_that_could_not_even_be_rejected_is_nobody_s_to_accept(
    tmp_path: Path, solved: Solved
) -> None:
    config = laser_config(tmp_path, update=AUTO)

    def full(*_: object) -> None:
        raise error("DISK_FULL", "no room")

    async def main() -> None:
        async with laser_cell(config, JOB, drawn_reference(config)) as cell:
            run_id = await cell.start()
            await cell.until_state("verify")
            reject, cell.ledger.reject = cell.ledger.reject, full  # type: ignore[method-assign,assignment]
            await cell.engine.halt(WHO)
            assert (await cell.finished(run_id))["outcome"] == "aborted"
            (row,) = cell.ledger.results(tool_calibration(TOOL))
            assert row["state"] == "accepted"
            refusal = await refused(cell.engine.decisions.accept(row["id"], WHO))
            assert (refusal.name, committed_tool(cell)) == ("NOT_NOW", None)
            assert "reject it" in str(refusal)
            cell.ledger.reject = reject  # type: ignore[method-assign]
            assert (await cell.engine.decisions.reject(row["id"], WHO, "never tried"))["state"] == "rejected"

    run_virtual(main())


def test_the_dry_run_of_an_update_lists_the_first_scan_and_moves_nothing(tmp_path: Path) -> None:
    config = laser_config(tmp_path)

    async def main() -> None:
        async with laser_cell(config, JOB, drawn_reference(config)) as cell:
            shown = await cell.dry_run()
            assert {row.get("place") for row in shown["plan"]["sweeps"]} == {None, 0}
            assert shown["plan"]["problems"] == []
            assert not [n for n in cell.journal(shown["run_id"]) if n["kind"] == "motion"]

    run_virtual(main())
