"""Targets of a check of a fixed camera: shown before, and nothing of them lost after, on virtual time."""

import asyncio
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cell.errors import error
from cell.guard import MotionGuard
from cell.poses import Array
from fakes.object import run_virtual
from procedures.eye_to_hand.words import axbc_plan_lines
from tests.chaos.matrix import Kind, inject_at, kind, put_right
from tests.kit.check_cell import AWAY, DRIVING, STEPS, check_cell, config, driven_run, once, wanted
from tests.kit.object_cell import WHO, ObjectCell, no_report
from tests.kit.solved import solve_axbc

__all__ = ["no_report"]
pytestmark = pytest.mark.usefixtures("no_report")

Way = Callable[[Array, Array], bool]


def refusing(patch: pytest.MonkeyPatch, refused: Way) -> None:
    """The guard of every arm refuses the ways that are ``refused`` as well."""
    genuine = MotionGuard.check_path_joints

    def check(self: MotionGuard, q0: Array, q1: Array) -> None:
        genuine(self, q0, q1)
        if refused(np.asarray(q0), np.asarray(q1)):
            raise error("MOTION_COLLISION", "a box that nobody planned with")

    patch.setattr(MotionGuard, "check_path_joints", check)


def home_of(cell: ObjectCell) -> Array:
    return np.array(cell.config.poses["home"], dtype=float)


def is_at_home(cell: ObjectCell) -> bool:
    at = cell.plant.world.track.at(cell.clock.now())[0]
    return cell.at_rest() and bool(np.allclose(at, home_of(cell), atol=1e-3))


def moves_of(cell: ObjectCell, run_id: int) -> list[list[float]]:
    return [line["q"] for line in cell.notes(run_id, "move_joints")]


def test_the_arm_goes_back_past_an_earlier_target_where_the_straight_way_is_not_free(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def main() -> None:
        async with check_cell(config(tmp_path, targets=wanted(*STEPS[:2]))) as cell:
            home, last = home_of(cell), np.zeros(6)

            def from_the_last(q0: Array, q1: Array) -> bool:
                return bool(np.allclose(q0, last, atol=1e-3) and np.allclose(q1, home, atol=1e-3))

            def told() -> None:
                run = cell.engine.run
                if run is not None and run.prompt is not None and DRIVING in run.prompt[1]:
                    (planned,) = cell.notes(run.id, "targets")
                    last[:] = planned["moves"][-1]["q"]

            cell.engine.subscribe(told)
            refusing(monkeypatch, from_the_last)
            run_id, _ = await driven_run(cell)
            assert cell.end(run_id)["outcome"] == "complete", cell.end(run_id)
            assert is_at_home(cell)
            driven = cell.result(run_id)["result"]["driven"]
            assert all(t["before"] for t in driven["targets"])
            assert "stands" not in driven
            first, second, back, end = moves_of(cell, run_id)[-4:]
            np.testing.assert_allclose(second, last, atol=1e-6)
            np.testing.assert_allclose(back, first)
            np.testing.assert_allclose(end, home, atol=1e-3)

    run_virtual(main())


def test_a_target_from_which_no_way_leads_back_is_left_out_before_anything_moves(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def main() -> None:
        async with check_cell(config(tmp_path, targets=wanted(STEPS[0]))) as cell:
            home = home_of(cell)

            def solving_or_later(q0: Array, q1: Array) -> bool:
                run = cell.engine.run
                planning = run is not None and "solve" in {s.value for _, s in run.visited}
                return planning and bool(np.allclose(q1, home, atol=1e-3))

            refusing(monkeypatch, solving_or_later)
            run_id, asked = await driven_run(cell)
            assert asked == "", "there is nothing to be driven to"
            driven = cell.result(run_id)["result"]["driven"]
            (lost,) = driven["lost"]
            assert lost.startswith("target 1 as given: no way back from there: ")
            assert is_at_home(cell)

    run_virtual(main())


def test_a_return_that_is_refused_costs_nothing_and_says_where_the_arm_stands(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def main() -> None:
        async with check_cell(config(tmp_path, targets=wanted(*STEPS[:2]))) as cell:

            def returning(q0: Array, q1: Array) -> bool:
                run = cell.engine.run
                seen = run is not None and len(cell.notes(run.id, "target seen")) == 2
                return seen and cell.state == "return"

            refusing(monkeypatch, returning)
            run_id, _ = await driven_run(cell)
            assert cell.end(run_id)["outcome"] == "complete", cell.end(run_id)
            assert cell.at_rest()
            assert not is_at_home(cell)
            result = cell.result(run_id)
            driven = result["result"]["driven"]
            assert all(t["before"] for t in driven["targets"])
            assert driven["stands"].startswith("the arm stands at target 2 as given: ")
            assert "a box that nobody planned with" in driven["stands"]
            assert driven["stands"].endswith("before the next job, else jog it away")
            assert [w["text"] for w in result["warnings"] if w["code"] == "targets.not-returned"] == [
                driven["stands"]
            ]
            assert result["verdict"] == "warn"
            assert solve_axbc(cell.folder(run_id).path)["result"] == result["result"]

    run_virtual(main())


def test_a_lease_that_refuses_a_target_for_good_ends_the_driving_and_not_the_run(tmp_path: Path) -> None:
    """In local mode an arm is lent to nobody: what was found before stands."""

    async def main() -> None:
        async with check_cell(config(tmp_path, targets=wanted(*STEPS[:2]))) as cell:

            async def to_local() -> None:
                cell.plant.plants["arm"].inject("local-mode", {})
                await cell.clock.sleep(1.0)

            run_id, _ = await driven_run(cell, asked_first=to_local)
            end, result = cell.end(run_id), cell.result(run_id)
            driven = result["result"]["driven"]
            assert end["outcome"] == "complete", end
            assert len(driven["lost"]) == 2, driven
            assert "local mode" in driven["lost"][0]
            assert "stands" not in driven, "it never left"
            assert [w["code"] for w in result["warnings"]] == ["targets.lost"]

    run_virtual(main())


def test_a_run_that_took_over_all_poses_goes_back_to_where_they_began(tmp_path: Path) -> None:
    async def main() -> None:
        async with check_cell(config(tmp_path, targets=wanted(*STEPS[:2]))) as cell:
            first, _ = await driven_run(cell, "skip")
            assert cell.result(first)["result"]["driven"]["lost"]
            second, _ = await driven_run(cell, adopt=first)
            assert cell.end(second)["outcome"] == "complete", cell.end(second)
            assert len(cell.notes(second, "pose taken")) == 0
            assert len(cell.notes(second, "target seen")) == 2
            assert is_at_home(cell)

    run_virtual(main())


def test_the_verdict_is_told_before_the_arm_is_driven(tmp_path: Path) -> None:
    async def main() -> None:
        async with check_cell(config(tmp_path, targets=wanted(STEPS[0])), off_m=0.004) as cell:
            _, asked = await driven_run(cell, "skip")
            verdict, _, moves = asked.partition("moves to targets")
            assert verdict.startswith("The check FAILED (max_error_t_m: the given hand-eye is off by ")
            assert "the given hand-eye does not fit the images" in verdict
            assert "by a constant, which moves them by up to " in moves
            assert "target 1 as given" in moves

    run_virtual(main())


def test_a_dry_run_lists_the_targets_with_joints_or_what_keeps_the_arm_from_them(tmp_path: Path) -> None:
    async def main() -> None:
        async with check_cell(config(tmp_path, targets=wanted(STEPS[0], AWAY))) as cell:
            plan = (await cell.dry_run())["plan"]
            near, away = plan["targets"]
            assert (near["number"], away["number"]) == (1, 2)
            assert len(near["q"]) == 6
            assert near["why"] == ""
            assert near["checks"]["joint_rad"] > 0.0
            assert away["q"] == []
            assert "reach" in away["why"]
            text = "\n".join(axbc_plan_lines(plan))
            assert "1 of 2 targets are driven to after the answer" in text
            assert f"target 2 is left out: {away['why']}" in text
            assert "corrected: not known before the poses are measured" in text
            assert moves_of(cell, 1) == []

    run_virtual(main())


def test_without_targets_a_dry_run_lists_none(tmp_path: Path) -> None:
    async def main() -> None:
        async with check_cell(config(tmp_path)) as cell:
            plan = (await cell.dry_run())["plan"]
            assert "targets" not in plan
            assert "targets" not in "\n".join(axbc_plan_lines(plan))

    run_virtual(main())


def test_a_run_that_is_finished_among_its_poses_asks_the_arm_for_nothing_more(tmp_path: Path) -> None:
    async def main() -> None:
        async with check_cell(config(tmp_path, targets=wanted(STEPS[0]))) as cell:
            run_id, _ = await driven_run(cell, meanwhile=once(cell, cell.engine.finish, taken=14))
            assert cell.end(run_id)["outcome"] == "complete", cell.end(run_id)
            assert cell.result(run_id)["result"]["driven"]["lost"] == [
                "target 1 as given: the run was finished early"
            ]
            assert cell.notes(run_id, "targets") == [], "no way was planned"
            states = [line["state"] for line in cell.journal(run_id) if "state" in line and "why" in line]
            assert states[-1] == "solve"
            assert states.count("solve") == 1

    run_virtual(main())


STOPPED = kind("arm", "protective-stop", "ARM_PROTECTIVE_STOP", set())


@pytest.mark.parametrize("fault", [STOPPED, None], ids=["fault", "abort"])
def test_a_run_that_ends_among_its_targets_keeps_the_check_and_what_was_seen(
    fault: Kind | None, tmp_path: Path
) -> None:
    async def main() -> None:
        made = config(tmp_path, targets=wanted(*STEPS[:3]), propose="camera", accept={"auto": True})
        async with check_cell(made) as cell:
            if fault is not None:
                inject_at(cell, fault, "move", 0.05, lambda run: bool(cell.notes(run.id, "target seen")))
            abort = None if fault is not None else once(cell, cell.engine.abort, seen=1)
            run_id, _ = await driven_run(cell, meanwhile=abort)
            end, result = cell.end(run_id), cell.result(run_id)
            assert end["outcome"] == ("stopped" if fault is None else "aborted"), end
            answer = result["result"]
            assert len(answer["places"]) >= 12
            assert answer["driven"]["targets"][0]["before"]
            assert answer["driven"]["lost"][-1] == "target 3 as given: the run ended before"
            assert len(answer["driven"]["lost"]) == 2
            assert "targets.lost" in [w["code"] for w in result["warnings"]]
            assert end["verdict"] == result["verdict"]
            assert solve_axbc(cell.folder(run_id).path)["result"] == answer
            assert cell.ledger.waiting_results() == [], "nothing is proposed by a run that was ended"
            assert cell.notes(run_id, "proposed") == []
            if fault is not None:
                await put_right(cell)

    run_virtual(main())


def test_a_run_that_ends_among_its_targets_says_why_others_were_left_out_or_lost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def main() -> None:
        made = config(tmp_path, poses=14, targets=wanted(AWAY, *STEPS[:2]))
        async with check_cell(made) as cell:

            def moving(q0: Array, q1: Array) -> bool:
                run = cell.engine.run
                return run is not None and cell.state == "move" and bool(cell.notes(run.id, "targets"))

            refusing(monkeypatch, moving)
            aborts: list[asyncio.Future[None]] = []

            def look() -> None:
                run = cell.engine.run
                if run is not None and cell.state == "return" and cell.notes(run.id, "target lost"):
                    aborts.append(asyncio.ensure_future(cell.engine.abort(WHO)))

            unsubscribe = cell.engine.subscribe(look)
            run_id, _ = await driven_run(cell)
            unsubscribe()
            assert cell.end(run_id)["outcome"] == "stopped", cell.end(run_id)
            away, *lost = cell.result(run_id)["result"]["driven"]["lost"]
            assert away == "target 1 as given: out of the arm's reach"
            assert len(lost) == 2
            assert all("a box that nobody planned with" in why for why in lost)

    run_virtual(main())


@pytest.mark.parametrize(
    ("failure", "why"),
    [(OSError("the disk"), "OSError: the disk"), (TimeoutError(), "it took longer than 30 s")],
    ids=["disk", "time"],
)
def test_an_answer_that_cannot_be_solved_again_falls_back_to_the_one_before(
    failure: Exception, why: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object) -> None:
        raise failure

    async def main() -> None:
        async with check_cell(config(tmp_path, targets=wanted(STEPS[0]))) as cell:
            monkeypatch.setattr("daemon.results.solve_again", broken)
            run_id, _ = await driven_run(cell, "abort")
            end, result = cell.end(run_id), cell.result(run_id)
            assert (end["outcome"], end["verdict"]) == ("stopped", "warn")
            assert len(result["result"]["places"]) >= 12
            assert "driven" not in result["result"]
            (note,) = cell.notes(run_id, "answer not solved again")
            assert note["why"] == why
            (warning,) = [w["text"] for w in result["warnings"] if w["code"] == "answer.not-renewed"]
            assert f"({why})" in warning
            assert warning.endswith(f"the data are kept: cellward solve axbc {cell.folder(run_id).path}")
            assert solve_axbc(cell.folder(run_id).path)["result"]["driven"]["lost"]
            assert cell.ledger.waiting_results() == [], "nothing is proposed by a run that was ended"

    run_virtual(main())


def test_a_run_that_ends_among_its_poses_has_no_answer(tmp_path: Path) -> None:
    async def main() -> None:
        async with check_cell(config(tmp_path, targets=wanted(STEPS[0]))) as cell:
            run_id, _ = await driven_run(cell, meanwhile=once(cell, cell.engine.abort, taken=14))
            assert cell.folder(run_id).read_result() is None

    run_virtual(main())
