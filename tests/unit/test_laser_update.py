"""From a bent tool to a committed tool frame, and every way in which a candidate is turned down instead."""

import asyncio
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cell.calibrations import laser_reference, time_offset, tool_calibration
from cell.errors import error
from cell.poses import from_pose6, to_pose6
from daemon.cli.replay import differences
from fakes.object import VirtualClock, run_virtual
from procedures.laser.config import Search
from procedures.laser.judging import judge_check
from procedures.replay import solve_again
from tests.object_cell import WHO, ObjectCell, no_report, on_disk, refused
from tests.unit.laser_cell import (
    TOOL,
    committed_tool,
    laser_cell,
    laser_config,
    passes,
    planned_once,
    point_of,
    states_of_results,
    the_plain_rule_misses,
    true_axis,
    true_point,
)
from tests.unit.laser_made import T_TOOL, Solved, drawn_reference, solved

__all__ = ["no_report", "planned_once", "solved"]
pytestmark = pytest.mark.usefixtures("no_report", "planned_once")

JOB = "laser-update"
BEND = ([0.0012, -0.0007, 0.0005], [0.006, -0.008, 0.0])  # 1.48 mm, 10 mrad
FINE = {
    "search_speed_m_s": 0.3,
    "measure_speed_m_s": 0.05,
    "passes": 2,
    "z_resolution_m": 0.0001,
    "lead_m": 0.003,
    "settle_s": 0.0,
}
ARM = {"state_period_s": 0.02}
POLL_S = 0.01
AUTO = {"accept": {"auto": True}}


def true_tip(cell: ObjectCell) -> Any:
    """(3,) m: the tool's point in the base, as it truly is."""
    world, now = cell.plant.world, cell.clock.now()
    return (world.true_flange(now) * world.T_flange_tool_at(now)).translation


def bent(cell: ObjectCell) -> None:
    cell.plant.world.tool.bend(cell.clock.now(), *BEND)


def test_a_bent_tool_is_measured_tried_and_written_within_its_uncertainty(tmp_path: Path) -> None:
    config = laser_config(tmp_path, reference=FINE, update=AUTO, quick=False)

    async def main() -> None:
        async with laser_cell(config, "laser-reference") as cell:
            made = await cell.run_job()
            assert (made["outcome"], made["verdict"]) == ("complete", "pass"), made
            (row,) = cell.ledger.results(laser_reference(TOOL))
            await cell.engine.accept(row["id"], WHO)
            bent(cell)
            end = await cell.run_job(job=JOB)
            assert (end["outcome"], end["verdict"]) == ("complete", "pass"), cell.result(2)["reasons"]
            result = cell.result(2)
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
            assert replayed(cell, 1) == []
            the_plain_rule_misses(cell.folder(2).path, result["result"], row["value"], 2.0 * BEND[0][0])
            now = await cell.engine.rollback(tool_calibration(TOOL), WHO)
            assert now["version"] is None, "one step back is the configured tool"

    run_virtual(main())


def replayed(cell: ObjectCell, run_id: int) -> list[Any]:
    """What differs when the run's data are solved again."""
    folder, recorded = cell.folder(run_id), cell.result(run_id)
    return differences(recorded, solve_again(folder.job, folder.path, folder.info, recorded))


def test_an_operator_is_shown_the_figures_and_a_confirm_accepts(tmp_path: Path, solved: Solved) -> None:
    config = laser_config(tmp_path)

    async def main() -> None:
        async with laser_cell(config, JOB, drawn_reference(config)) as cell:
            run_id = await cell.start()
            await cell.until_state("ask")
            assert cell.at_rest()
            assert cell.engine.status()["packml"] == "HELD"
            text = cell.engine.status()["prompt"]["text"]
            assert "moved by +1.000, -0.700, +0.000 mm in the flange" in text
            assert "the tilt was not measured (95 % uncertainty of the point 0.100 mm)" in text
            (row,) = cell.ledger.results(tool_calibration(TOOL))
            for outside in (cell.engine.accept(row["id"], WHO), cell.engine.reject(row["id"], WHO, "no")):
                assert (await refused(outside)).name == "NOT_NOW"
            end = await cell.finished(run_id)
            assert end["verdict"] == "pass"
            assert states_of_results(cell) == ["committed"]
            assert committed_tool(cell) == [0.001, -0.0007, 0.18, 0.0, 0.0, 0.0]
            assert cell.result(run_id)["inputs"]["update"]["accepted_by"] == "operator"
            assert replayed(cell, run_id) == []
            R = from_pose6([0.0, 0.0, 0.0, *drawn_reference(config)["R_base_flange"]])
            first, second = sweeps_of(cell, run_id)
            # The second scan goes to its own start first, then its point takes the way of the reference's.
            assert np.array(second[1]) - first[0] == pytest.approx(-R.apply(np.array(solved.dp)), abs=1e-9)

    run_virtual(main())


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


def asked(cell: ObjectCell, state: str, what: Callable[[], Any]) -> list[Any]:
    tasks: list[asyncio.Task[Any]] = []
    cell.at_state(state, lambda: tasks.append(asyncio.create_task(what())))
    return tasks


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
            refusal = await refused(cell.engine.accept(row["id"], WHO))
            assert (refusal.name, committed_tool(cell)) == ("NOT_NOW", None)
            assert "reject it" in str(refusal)
            cell.ledger.reject = reject  # type: ignore[method-assign]
            assert (await cell.engine.reject(row["id"], WHO, "never tried"))["state"] == "rejected"

    run_virtual(main())


LIMITS = {"max_shift_m": 0.01, "max_tilt_rad": 0.1}
NARROW = {
    "against_reference": {"max_shift_m": 0.001, "max_tilt_rad": 0.1},
    "against_last": {"max_shift_m": 0.01, "max_tilt_rad": 0.005},
    "max_U_m": 0.00005,
    "max_latency_s": 0.02,
}


@pytest.mark.parametrize(
    ("key", "told"),
    [
        (
            "against_reference",
            "bent tool: against_reference.max_shift_m: the point is 1.22 mm off the reference",
        ),
        ("against_last", "bent tool: against_last.max_tilt_rad: the axis is 0.57 deg off the last result"),
        ("max_U_m", "max_U_m: 95 % of the errors stay below 0.1 mm, the limit is 0.05 mm"),
        ("max_latency_s", None),
    ],
)
def test_what_is_beyond_a_limit_fails_by_its_name_and_stays_filled(key: str, told: str | None) -> None:
    answer = Solved(drot=[0.006, 0.008, 0.0], tau=0.05)
    wide = {"against_reference": LIMITS, "against_last": LIMITS, "max_U_m": 0.001, "max_latency_s": 0.1}
    known = {"T_flange_tool_ref": T_TOOL, "T_flange_tool_last": T_TOOL, "offset_s": 0.01}
    assert judge_check(answer.current(), known, wide)["verdict"] == "pass"
    result = judge_check(answer.current(), known, {**wide, key: NARROW[key]})
    assert result["result"]["T_flange_tool"][:3] == pytest.approx([0.001, -0.0007, 0.18])
    if told is None:
        assert (result["verdict"], result["reasons"]) == ("warn", [])
        assert "late by 60.0 ms, configured are 10.0 ms" in result["warnings"][0]["text"]
    else:
        assert result["verdict"] == "fail"
        assert result["reasons"][0].startswith(told)


def test_the_last_result_is_another_tool_than_the_reference() -> None:
    known = {"T_flange_tool_ref": T_TOOL, "T_flange_tool_last": [0.002, *T_TOOL[1:]], "offset_s": 0.0}
    wide = {"against_reference": LIMITS, "against_last": LIMITS, "max_U_m": 0.001, "max_latency_s": 0.1}
    result = judge_check(Solved().current(), known, wide)["result"]
    assert result["against_last"]["shift_m"] == pytest.approx([-0.001, -0.0007, 0.0])
    assert result["against_reference"]["shift_m"] == pytest.approx([0.001, -0.0007, 0.0])


def test_a_bent_tool_is_not_proposed_and_not_tried(tmp_path: Path, solved: Solved) -> None:
    config = laser_config(tmp_path, update={**AUTO, "against_reference": NARROW["against_reference"]})

    async def main() -> None:
        async with laser_cell(config, JOB, drawn_reference(config)) as cell:
            end = await cell.run_job()
            assert (end["outcome"], end["verdict"]) == ("complete", "fail")
            assert states_of_results(cell) == []
            assert "second" not in {f.name for f in cell.folder(1).path.iterdir()}

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


def test_passes_are_late_by_what_the_reference_was_whatever_delay_was_found_since(
    tmp_path: Path, solved: Solved
) -> None:
    config = laser_config(tmp_path)

    async def main() -> None:
        async with laser_cell(config, "laser-check", drawn_reference(config)) as cell:
            await cell.run_job()
            offset = cell.ledger.propose(time_offset("beams"), 0.004, {"verdict": "pass"}, 0, 0.0)
            on_disk(cell.ledger.accept, offset, WHO)
            await cell.run_job()
            polls = [np.array(passes(cell, run_id)[0]["poll_t"]) for run_id in (1, 2)]
            first, second = (np.angle(np.exp(2j * np.pi * t / POLL_S)) for t in polls)  # within a period
            turned = np.abs(np.angle(np.exp(1j * (second[0] - first[0]))))
            assert turned < 0.01, "the polls' stamps moved"

    run_virtual(main())


def test_a_floor_that_was_raised_since_the_reference_holds(tmp_path: Path) -> None:
    config = laser_config(tmp_path)
    reference = drawn_reference(config)
    low = Search.from_reference(reference, None)
    assert Search.from_reference(reference, low.floor_m + 0.02).floor_m == low.floor_m + 0.02
    assert Search.from_reference(reference, low.floor_m - 0.02).floor_m == low.floor_m


def test_a_tool_left_between_the_sensors_goes_straight_up_first(tmp_path: Path, solved: Solved) -> None:
    config = laser_config(tmp_path)

    async def main() -> None:
        async with laser_cell(config, "laser-check", drawn_reference(config)) as cell:
            run_id = await cell.start()
            await cell.until_state("measure")
            await cell.until_state("return")
            await cell.engine.abort(WHO)
            await cell.finished(run_id)
            left = true_tip(cell)
            second = await cell.start()
            await cell.until(lambda: cell.notes(second, "move_linear"), "the first move", 30.0)
            way = [left]

            def goes_on() -> bool:
                if cell.notes(second, "move_joints"):
                    return True
                way.append(true_tip(cell))
                return False

            await cell.until(goes_on, "the second move", 30.0)
            up = way[-1] - left
            assert up[2] > 0.005
            assert float(np.linalg.norm(up[:2])) < 1e-4
            assert cell.notes(second, "lifted first")
            await cell.finished(second)

    run_virtual(main())


def test_a_check_measures_and_proposes_nothing(tmp_path: Path, solved: Solved) -> None:
    config = laser_config(tmp_path)

    async def main() -> None:
        async with laser_cell(config, "laser-check", drawn_reference(config)) as cell:
            end = await cell.run_job()
            assert (end["outcome"], end["verdict"]) == ("complete", "fail")
            assert states_of_results(cell) == []
            assert replayed(cell, 1) == []
            trend = cell.result(1)["inputs"]["trend"]
            assert [value for _, value in trend[f"tool.offset_y_m.{TOOL}"]] == [-0.0007]

    run_virtual(main())


def test_a_pause_holds_between_two_ways_and_a_resume_goes_on(tmp_path: Path, solved: Solved) -> None:
    config = laser_config(tmp_path)

    async def main() -> None:
        async with laser_cell(config, "laser-check", drawn_reference(config)) as cell:
            run_id = await cell.start()
            await cell.until_state("return")
            await cell.engine.pause(WHO)
            await cell.until(lambda: cell.engine.status()["packml"] == "HELD", "hold")
            assert cell.at_rest()
            taken = len(passes(cell, run_id))
            await cell.clock.sleep(5.0)
            assert cell.engine.status()["state"] == "sweep"
            assert len(passes(cell, run_id)) == taken == 2
            await cell.engine.resume(WHO)
            assert (await cell.finished(run_id))["outcome"] == "complete"

    run_virtual(main())


def test_the_dry_run_of_an_update_lists_the_first_scan_and_moves_nothing(tmp_path: Path) -> None:
    config = laser_config(tmp_path)

    async def main() -> None:
        async with laser_cell(config, JOB, drawn_reference(config)) as cell:
            shown = await cell.engine.start(JOB, {}, dry_run=True, who=WHO, channel="test")
            assert {row.get("place") for row in shown["plan"]["sweeps"]} == {None, 0}
            assert shown["plan"]["problems"] == []
            assert not [n for n in cell.journal(shown["run_id"]) if n["kind"] == "motion"]

    run_virtual(main())


def test_a_pose_taught_anew_makes_the_reference_another_fixture_s(tmp_path: Path) -> None:
    config = laser_config(tmp_path)
    reference = drawn_reference(config)
    reference["search"]["ys"]["q"][5] += 0.001

    async def main() -> None:
        async with laser_cell(config, "laser-check", reference) as cell:
            refusal = await refused(cell.start())
            assert refusal.name == "LASER_OTHER_FIXTURE"
            assert "'aux_ys' was taught anew" in str(refusal)

    run_virtual(main())


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"device": "others"}, "it used the inputs 'others', not 'beams'"),
        ({"xs": {"input": "zs"}}, "beams has no input 'zs', there is xs, ys"),
    ],
)
def test_a_reference_of_other_inputs_is_another_fixture_s(
    change: dict[str, Any], told: str, tmp_path: Path
) -> None:
    config = laser_config(tmp_path)
    reference = drawn_reference(config)
    for key, value in change.items():
        search = reference["search"]
        search[key] = {**search[key], **value} if isinstance(value, dict) else value

    async def main() -> None:
        async with laser_cell(config, "laser-check", reference) as cell:
            end = await cell.run_job()
            assert end["error"]["name"] == "LASER_OTHER_FIXTURE"
            assert told in end["error"]["text"]
            assert not [line for line in cell.journal(1) if line["kind"] == "motion"]

    run_virtual(main())


def test_a_run_of_the_beams_cannot_be_adopted(tmp_path: Path) -> None:
    config = laser_config(tmp_path)

    async def main() -> None:
        async with laser_cell(config, "laser-check", drawn_reference(config)) as cell:
            tasks = asked(cell, "return", lambda: cell.engine.abort(WHO))
            await cell.run_job()
            await asyncio.wait(tasks)
            end = await cell.run_job(adopt=1)
            assert end["error"]["name"] == "NOT_NOW"
            assert "start anew" in end["error"]["text"]

    run_virtual(main())
