"""Steering a job from outside: finish, pause, abort, halt, and what is refused."""

import asyncio
from pathlib import Path
from typing import Any

import pytest

from cell.errors import CellError, error
from cell.packml import PackML
from daemon.run_end import write_end
from fakes.object import run_virtual
from tests.kit.hand_eye_made import quick_solver
from tests.kit.object_cell import JOB, WHO, no_report, open_cell, refused, write_config

__all__ = ["no_report", "quick_solver"]
pytestmark = pytest.mark.usefixtures("no_report", "quick_solver")


@pytest.mark.parametrize("silent_s", [0.08, 5.0])
def test_a_start_waits_for_an_arm_that_is_silent_for_a_moment_and_is_refused_when_it_stays_so(
    silent_s: float, tmp_path: Path
) -> None:
    async def main() -> None:
        async with open_cell(write_config(tmp_path)) as cell:
            cell.plant.plant("arm").inject("silence", {"duration_s": silent_s})
            await cell.clock.sleep(0.07)
            with pytest.raises(CellError, match="newest sample"):
                cell.engine._arm().check_movable()  # type: ignore[union-attr]
            if silent_s > 1.0:
                assert "arm" in str(await refused(cell.start()))
                return
            run_id = await cell.start()
            await cell.engine.halt(WHO)
            await cell.finished(run_id)

    run_virtual(main())


@pytest.mark.parametrize("verb", ["abort", "halt"])
@pytest.mark.parametrize("times", [1, 2, 3])
@pytest.mark.parametrize("state", ["place", "move", "capture", "solve"])
def test_abort_stops_and_halt_aborts_however_often_they_are_asked(
    verb: str, times: int, state: str, tmp_path: Path
) -> None:
    async def main() -> None:
        async with open_cell(write_config(tmp_path, job={"poses_per_placement": 3})) as cell:
            run_id = await cell.start()
            await cell.until_state(state)
            for _ in range(times):
                if cell.engine.active:
                    await getattr(cell.engine, verb)(WHO)
                await cell.clock.sleep(0.001)
            end = await cell.finished(run_id)
            outcome, packml = ("stopped", "STOPPED") if verb == "abort" else ("halted", "ABORTED")
            assert (end["outcome"], end["packml"], end["error"]) == (outcome, packml, None)
            assert cell.engine.packml.name == packml
            assert cell.at_rest()
            assert cell.ledger.results() == []
            await cell.engine.reset(WHO)
            assert cell.engine.packml is PackML.IDLE

    run_virtual(main())


def test_a_stop_right_behind_the_start_is_not_lost(tmp_path: Path) -> None:
    async def main() -> None:
        async with open_cell(write_config(tmp_path)) as cell:
            run_id = await cell.start()
            await cell.engine.abort(WHO)
            assert (await cell.finished(run_id))["outcome"] == "stopped"
            assert cell.notes(run_id, "lease") == []

    run_virtual(main())


@pytest.mark.parametrize(("verb", "outcome"), [("abort", "stopped"), ("halt", "halted")])
def test_a_stop_while_the_run_is_being_made_ends_it_before_it_begins(
    verb: str, outcome: str, tmp_path: Path
) -> None:
    async def main() -> None:
        async with open_cell(write_config(tmp_path)) as cell:
            start = asyncio.create_task(cell.start(placed=False))
            await asyncio.sleep(0)  # the start now waits for the ledger
            assert not start.done()
            await getattr(cell.engine, verb)("another channel")
            run_id = await start
            assert (await cell.finished(run_id))["outcome"] == outcome
            assert cell.notes(run_id, "lease") == []
            assert (await cell.run_job())["outcome"] == "complete"  # the stop was that run's alone

    run_virtual(main())


def test_a_full_disk_does_not_keep_a_stop_from_stopping(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def main() -> None:
        async with open_cell(write_config(tmp_path, job={"poses_per_placement": 3})) as cell:
            run_id = await cell.start()
            await cell.until_state("move")
            run = cell.engine.run
            assert run is not None

            def full(kind: str, **fields: Any) -> None:
                raise error("DISK_FULL", "journal.jsonl")

            with monkeypatch.context() as disk:
                disk.setattr(run, "note", full)
                with pytest.raises(CellError, match="full"):
                    await cell.engine.halt(WHO)
            assert (await cell.finished(run_id))["outcome"] == "halted"
            assert cell.at_rest()

    run_virtual(main())


@pytest.mark.parametrize(("state", "seen"), [("place", 1), ("place", 2), ("seek", 2), ("move", 3)])
def test_finish_at_a_checkpoint_keeps_the_data_and_solves(state: str, seen: int, tmp_path: Path) -> None:
    config = write_config(tmp_path, job={"placements": 2})

    async def main() -> None:
        async with open_cell(config) as cell:
            finish: list[asyncio.Task[Any]] = []
            entered = 0

            def count() -> None:
                nonlocal entered
                run = cell.engine.run
                visited = [b.value for _, b in run.visited] if run else []
                if visited.count(state) == seen and entered != len(visited) and not finish:
                    finish.append(asyncio.create_task(cell.engine.finish(WHO)))
                entered = len(visited)

            cell.engine.subscribe(count)
            end = await cell.finished(await cell.start(placed=False))
            await asyncio.wait(finish)
            path = cell.folder(1).path / "poses.jsonl"
            poses = path.read_text("utf-8").count('"kind": "pose"')
            if poses == 0:
                assert end["error"]["name"] == "CAPTURE_INCOMPLETE"
            else:
                assert end["outcome"] == "complete"
                assert len(cell.poses(1)) == poses < 8
                assert cell.result(1)["schema"] == "cellward.result/1"

    run_virtual(main())


def test_finish_answers_an_open_prompt(tmp_path: Path) -> None:
    async def main() -> None:
        async with open_cell(write_config(tmp_path, job={"placements": 2})) as cell:
            run_id = await cell.start()
            await cell.until(lambda: cell.engine.status()["prompt"], "prompt")
            assert cell.engine.packml is PackML.HELD
            await cell.engine.finish(WHO)
            await cell.until(lambda: not cell.engine.active, "end")
            assert cell.end(run_id)["outcome"] == "complete"
            assert {o["group"] for o in cell.poses(run_id)} == {0}

    run_virtual(main())


def test_pause_holds_at_rest_until_resume(tmp_path: Path) -> None:
    async def main() -> None:
        async with open_cell(write_config(tmp_path)) as cell:
            run_id = await cell.start()
            await cell.until_state("settle")
            await cell.engine.pause(WHO)
            assert cell.engine.packml is PackML.HOLDING
            await cell.until_state("capture")
            assert cell.engine.packml is PackML.HOLDING, "still on the way to the checkpoint"
            await cell.until(lambda: cell.engine.packml is PackML.HELD, "Held")
            where = cell.plant.world.track.at(cell.clock.now())[0]
            await cell.engine.pause(WHO)
            assert cell.engine.packml is PackML.HELD, "pausing twice changes nothing"
            await cell.clock.sleep(30.0)
            assert cell.at_rest()
            assert (cell.plant.world.track.at(cell.clock.now())[0] == where).all()
            await cell.engine.resume(WHO)
            end = await cell.finished(run_id)
            assert end["outcome"] == "complete"
            names = [n["packml"] for n in cell.journal(run_id) if "packml" in n and not n.get("terminal")]
            assert names == ["HELD", "EXECUTE", "HOLDING", "HELD", "UNHOLDING", "EXECUTE"]  # first the prompt

    run_virtual(main())


def test_resume_before_the_checkpoint_takes_the_pause_back(tmp_path: Path) -> None:
    async def main() -> None:
        async with open_cell(write_config(tmp_path)) as cell:
            run_id = await cell.start()
            await cell.until_state("settle")
            await cell.engine.pause(WHO)
            await cell.engine.resume(WHO)
            assert cell.engine.packml is PackML.EXECUTE
            assert (await cell.finished(run_id))["outcome"] == "complete"
            held = [n for n in cell.journal(run_id) if n.get("packml") == "HELD"]
            assert len(held) == 1, "only while it asked for the first placement"

    run_virtual(main())


@pytest.mark.parametrize("way_out", ["abort", "halt", "finish"])
def test_a_held_job_can_still_be_ended(way_out: str, tmp_path: Path) -> None:
    async def main() -> None:
        async with open_cell(write_config(tmp_path)) as cell:
            run_id = await cell.start()
            await cell.until_state("settle")
            await cell.engine.pause(WHO)
            await cell.until(lambda: cell.engine.packml is PackML.HELD, "Held")
            await getattr(cell.engine, way_out)(WHO)
            end = await cell.finished(run_id)
            assert end["outcome"] == {"abort": "stopped", "halt": "halted", "finish": "complete"}[way_out]
            assert cell.at_rest()

    run_virtual(main())


def test_a_job_that_takes_too_long_is_ended(tmp_path: Path) -> None:
    async def main() -> None:
        async with open_cell(write_config(tmp_path, job={"max_duration_s": 3.0})) as cell:
            end = await cell.run_job()
            assert (end["packml"], end["error"]["name"]) == ("ABORTED", "CALL_TIMEOUT")
            assert cell.at_rest()

    run_virtual(main())


def test_one_job_at_a_time_even_when_two_start_at_once(tmp_path: Path) -> None:
    async def main() -> None:
        async with open_cell(write_config(tmp_path)) as cell:
            answers = await asyncio.gather(cell.start(), cell.start(), return_exceptions=True)
            assert [a for a in answers if isinstance(a, int)] == [1]
            assert [getattr(a, "name", None) for a in answers if not isinstance(a, int)] == ["BUSY"]
            assert (await refused(cell.start())).name == "BUSY"
            assert (await refused(cell.start(dry_run=True))).name == "BUSY"
            assert (await refused(cell.engine.reset(WHO))).name == "NOT_NOW"
            assert (await cell.finished(1))["outcome"] == "complete"

    run_virtual(main())


@pytest.mark.parametrize("verb", ["finish", "abort", "halt", "pause", "resume"])
def test_an_idle_engine_refuses_to_steer(verb: str, tmp_path: Path) -> None:
    async def main() -> None:
        async with open_cell(write_config(tmp_path)) as cell:
            assert (await refused(getattr(cell.engine, verb)(WHO))).name == "NOT_NOW"

    run_virtual(main())


@pytest.mark.parametrize(
    ("job", "params", "name"),
    [
        ("make-coffee", {}, "UNKNOWN_JOB"),
        (JOB, {"sugar": "2"}, "ARGUMENT_INVALID"),
        (JOB, {"placements": "many"}, "ARGUMENT_INVALID"),
        (JOB, {"placements": "0"}, "ARGUMENT_INVALID"),
        (JOB, {"target": "nowhere"}, "ARGUMENT_INVALID"),
        (JOB, {"start_pose": "nowhere"}, "ARGUMENT_INVALID"),
        (JOB, {"setup": "eye-to-hand"}, "DEVICE_NOT_READY"),
    ],
)
def test_a_wrong_start_is_refused_and_leaves_no_run(
    job: str, params: dict[str, str], name: str, tmp_path: Path
) -> None:
    async def main() -> None:
        async with open_cell(write_config(tmp_path)) as cell:
            refusal = await refused(cell.start(job=job, params=params))
            assert refusal.name == name
            assert list(cell.runs.iterdir()) == []
            assert not cell.engine.active

    run_virtual(main())


def test_a_parameter_overrides_the_configuration(tmp_path: Path) -> None:
    async def main() -> None:
        async with open_cell(write_config(tmp_path)) as cell:
            await cell.run_job(params={"poses_per_placement": "3"})
            assert len(cell.poses(1)) == 3
            assert cell.folder(1).info["job_config"]["poses_per_placement"] == 3

    run_virtual(main())


def test_a_device_that_is_not_ready_is_named(tmp_path: Path) -> None:
    async def main() -> None:
        async with open_cell(write_config(tmp_path)) as cell:
            cell.plant.camera.inject("refuse")
            await cell.clock.sleep(1.0)
            refusal = await refused(cell.start())
            assert refusal.name == "DEVICE_NOT_READY"
            assert "camera" in refusal.detail
            cell.plant.camera.clear()
            await cell.until(cell.all_ready, "camera back", 20.0)
            assert (await cell.run_job())["outcome"] == "complete"

    run_virtual(main())


def test_a_protective_stop_locks_motion_until_a_reset_that_the_fault_no_longer_forbids(
    tmp_path: Path,
) -> None:
    async def main() -> None:
        async with open_cell(write_config(tmp_path)) as cell:
            run_id = await cell.start()
            await cell.until_state("move")
            await cell.clock.sleep(0.2)
            cell.plant.controller.inject("protective-stop")
            end = await cell.finished(run_id)
            assert (end["packml"], end["error"]["name"]) == ("ABORTED", "ARM_PROTECTIVE_STOP")
            assert cell.engine.status()["latched"]
            assert (await refused(cell.start())).name == "ARM_PROTECTIVE_STOP"
            assert (await refused(cell.engine.reset(WHO))).name == "NOT_NOW"
            cell.plant.controller.clear()
            await cell.clock.sleep(0.1)
            assert (await refused(cell.start())).name == "MOTION_LATCHED"
            await cell.engine.reset(WHO)
            assert not cell.engine.status()["latched"]
            assert (await cell.run_job())["outcome"] == "complete"

    run_virtual(main())


def test_local_mode_while_the_job_waits_for_the_board_costs_nothing(tmp_path: Path) -> None:
    async def main() -> None:
        async with open_cell(write_config(tmp_path, job={"placements": 2})) as cell:
            run_id = await cell.start()
            await cell.until(lambda: cell.engine.run and cell.engine.run.prompt, "a prompt")
            cell.plant.controller.inject("local-mode")
            await cell.clock.sleep(30.0)
            assert cell.engine.active
            cell.plant.controller.clear()
            assert (await cell.finished(run_id))["outcome"] == "complete"

    run_virtual(main())


def test_an_arm_left_in_local_mode_is_refused_by_the_next_lease(tmp_path: Path) -> None:
    async def main() -> None:
        async with open_cell(write_config(tmp_path, job={"placements": 2})) as cell:
            run_id = await cell.start()
            await cell.until(lambda: cell.engine.run and cell.engine.run.prompt, "a prompt")
            cell.plant.controller.inject("local-mode")
            await cell.clock.sleep(1.0)
            end = await cell.finished(run_id)
            assert (end["outcome"], end["error"]["name"]) == ("aborted", "ARM_LOCAL_MODE")
            assert cell.at_rest()

    run_virtual(main())


def test_local_mode_while_the_arm_is_lent_ends_the_job(tmp_path: Path) -> None:
    async def main() -> None:
        async with open_cell(write_config(tmp_path)) as cell:
            run_id = await cell.start()
            await cell.until_state("capture")
            cell.plant.controller.inject("local-mode")
            end = await cell.finished(run_id)
            assert (end["outcome"], end["error"]["name"]) == ("aborted", "ARM_LOCAL_MODE")

    run_virtual(main())


def test_the_end_of_the_daemon_halts_the_job_first(tmp_path: Path) -> None:
    async def main() -> None:
        async with open_cell(write_config(tmp_path)) as cell:
            run_id = await cell.start()
            await cell.until_state("move")
            await cell.clock.sleep(0.3)
            assert not cell.at_rest()
            await cell.engine.shutdown()
            assert cell.at_rest()
            assert cell.end(run_id)["outcome"] == "halted"

    run_virtual(main())


def test_the_end_of_the_daemon_waits_for_an_end_that_is_being_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def main() -> None:
        async with open_cell(write_config(tmp_path)) as cell:
            shut: list[asyncio.Task[None]] = []

            async def written(*args: Any) -> Any:
                shut.append(asyncio.create_task(cell.engine.shutdown()))
                await asyncio.sleep(0)
                return await write_end(*args)

            monkeypatch.setattr("daemon.engine.write_end", written)
            run_id = await cell.start()
            await cell.until_state("move")
            await cell.engine.abort("the operator")
            assert (await cell.finished(run_id))["outcome"] == "stopped"
            await shut[0]

    run_virtual(main())
