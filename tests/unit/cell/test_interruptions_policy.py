"""What a short silence may cost and what ends a run all the same, at a capture on virtual time."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cell.errors import LatchError
from cell.interruptions import Interruptions
from cell.packml import PackML
from cell.procedure import Run
from fakes.object import run_virtual
from tests.chaos.test_engine_fault_matrix import BRISK, PLAN, check_stops, quick_solver
from tests.kit.interrupted import Struck, run_struck, silence_at
from tests.kit.object_cell import ObjectCell, no_report, open_cell, write_config

__all__ = ["no_report", "quick_solver"]
pytestmark = pytest.mark.usefixtures("no_report", "quick_solver")

SILENT_S, ON_THE_WAY_S = 1.5, 0.15


def struck_run(
    folder: Path, prepare: Callable[[Struck], Any], job: dict[str, Any] | None = None, **sections: Any
) -> tuple[Struck, ObjectCell]:
    config = write_config(folder, job={**PLAN, "placements": 1, **(job or {})}, limits=BRISK, **sections)

    async def main() -> Struck:
        async with open_cell(config) as cell:
            subject = Struck(cell)
            prepare(subject)
            await run_struck(subject)
            check_stops(cell)
            if subject.end["outcome"] == "complete":
                subject.tells_the_same_everywhere()
            return subject

    subject = run_virtual(main())
    return subject, subject.cell


def again_and_again(subject: Struck, times: int, apart_s: float, moment: str = "move") -> None:
    """The arm drops ``times``, so long after it is on the way again."""
    cell, plant, left = subject.cell, subject.cell.plant.plants["arm"], times

    def look() -> None:
        nonlocal left
        run = cell.engine.running
        if run is None or run.state is None or run.state.value != moment or run.steps_taken.waiting:
            return
        if left and len(subject.at) < 1 + len(run.steps_taken.taken_again):
            left -= 1
            subject.at.append(moment)
            plant.later(apart_s, lambda: plant.inject("drop"))

    cell.engine.subscribe(look)


def test_two_in_a_row_are_borne_and_the_third_ends_the_run_by_its_own_name(tmp_path: Path) -> None:
    for times, outcome in ((2, "complete"), (3, "aborted")):
        folder = tmp_path / str(times)
        folder.mkdir()
        subject, _ = struck_run(folder, lambda s, n=times: again_and_again(s, n, ON_THE_WAY_S))
        assert len(subject.at) == times
        assert subject.end["outcome"] == outcome, subject.end["error"]
        if times == 3:
            assert subject.end["error"]["name"] == "DEVICE_LOST"
            assert len(subject.cell.notes(1, "step taken again")) == 2


def test_an_arm_that_was_moved_meanwhile_ends_the_run(tmp_path: Path) -> None:
    def jog(subject: Struck) -> None:
        world = subject.cell.plant.world

        def carried(run: Run) -> None:
            subject.cell.plant.controller.later(0.6, away)  # after our watchdog has ended our script

        def away() -> None:
            now = subject.cell.clock.now()
            world.track.hold(now, world.track.at(now)[0] + np.array([2.5, 0.0, 0.0, 0.0, 0.0, 0.0]))

        silence_at(subject, "arm", "settle", SILENT_S, 0.0, carried)

    subject, _ = struck_run(tmp_path, jog)
    assert subject.end["error"]["name"] == "ARM_MOVED"
    assert subject.cell.notes(1, "step taken again") == []
    assert subject.plc.snapshot()["steps_taken_again"] == 0, "none was"


@pytest.mark.parametrize(
    ("fault", "name"),
    [
        ("foreign-program", "ARM_PROGRAM_RUNNING"),
        ("protective-stop", "ARM_PROTECTIVE_STOP"),
        ("emergency-stop", "ARM_EMERGENCY_STOP"),
        ("local-mode", "ARM_LOCAL_MODE"),
    ],
)
def test_what_happens_to_the_arm_during_a_silence_ends_the_run_by_its_own_name(
    fault: str, name: str, tmp_path: Path
) -> None:
    def during(subject: Struck) -> None:
        controller = subject.cell.plant.controller
        silence_at(subject, "arm", "move", SILENT_S, ON_THE_WAY_S, lambda run: controller.inject(fault))

    subject, _ = struck_run(tmp_path, during)
    assert subject.end["error"]["name"] == name
    assert subject.cell.notes(1, "step taken again") == []


@pytest.mark.parametrize(
    ("fault", "arguments", "name"),
    [
        ("safeguard-stop", {"duration_s": 0.4}, "ARM_SAFEGUARD_STOP"),  # over before the camera is back
        ("emergency-stop", {}, "ARM_EMERGENCY_STOP"),
    ],
)
def test_a_safety_stop_while_another_device_is_waited_for_ends_the_run_at_once(
    fault: str, arguments: dict[str, Any], name: str, tmp_path: Path
) -> None:
    struck_at: list[float] = []

    def during(subject: Struck) -> None:
        cell, controller = subject.cell, subject.cell.plant.controller

        def strike() -> None:
            struck_at.append(cell.clock.now())
            controller.inject(fault, arguments)

        def away() -> None:
            cell.plant.plants["camera"].inject("drop")
            cell.plant.plants["camera"].inject("refuse", {"duration_s": 1.5})
            controller.later(0.5, strike)

        cell.at_state("settle", away)

    subject, cell = struck_run(tmp_path, during)
    assert subject.end["error"]["name"] == name
    (ended,) = [line["t"] for line in cell.journal(1) if line["kind"] == "error"]
    assert ended - struck_at[0] < 0.3, "it was not known before the camera was back"
    assert cell.notes(1, "step taken again") == []
    assert isinstance(cell.engine.context.broker.latched, LatchError) is (fault == "emergency-stop")


@pytest.mark.parametrize(("verb", "outcome"), [("abort", "stopped"), ("halt", "halted")])
def test_a_stop_during_a_wait_works_at_once(verb: str, outcome: str, tmp_path: Path) -> None:
    asked: list[float] = []

    def stop(subject: Struck) -> None:
        engine, clock = subject.cell.engine, subject.cell.clock

        def now(run: Run) -> None:
            asked.append(clock.now())
            engine._end_with(PackML.STOPPING if verb == "abort" else PackML.ABORTING, verb, "test")

        silence_at(subject, "arm", "move", SILENT_S, ON_THE_WAY_S, now)

    subject, cell = struck_run(tmp_path, stop)
    assert subject.end["outcome"] == outcome
    assert cell.notes(1, "step taken again") == []


def test_a_pause_during_a_wait_holds_before_the_arm_moves_again(tmp_path: Path) -> None:
    seen: list[str] = []

    def hold(subject: Struck) -> None:
        cell = subject.cell

        def now(run: Run) -> None:
            cell.engine.hold("test")
            cell.plant.plants["arm"].later(6.0, lambda: held(run))

        def held(run: Run) -> None:
            moves = [line["event"] for line in cell.journal(run.id) if line["kind"] == "motion"]
            seen.extend([cell.engine.packml.name, moves[-1]])
            assert cell.at_rest()
            run.resume()

        silence_at(subject, "arm", "move", SILENT_S, ON_THE_WAY_S, now)

    subject, cell = struck_run(tmp_path, hold)
    assert seen[0] == "HELD"
    events = [line.get("event") or line.get("packml") for line in cell.journal(1)]
    began = events.index("interrupted")
    assert "move_joints" not in events[began : events.index("HELD", began)]
    assert subject.end["outcome"] == "complete", subject.end["error"]


def test_a_finish_during_a_wait_ends_the_job_before_the_arm_moves_to_measure_again(tmp_path: Path) -> None:
    def finish(subject: Struck) -> None:
        silence_at(subject, "arm", "settle", SILENT_S, 0.0, lambda run: run.finish())

    subject, cell = struck_run(tmp_path, finish)
    assert subject.end["error"]["name"] == "CAPTURE_INCOMPLETE", "it was the first pose"
    events = [line.get("event") for line in cell.journal(1)]
    assert "move_joints" not in events[events.index("interrupted") :]


def test_a_pose_with_a_gap_in_the_stream_that_nobody_noticed_is_taken_again(tmp_path: Path) -> None:
    def gap(subject: Struck) -> None:
        cell = subject.cell

        def forget(*_: Any) -> None:
            state = cell.context.device("arm").state  # type: ignore[attr-defined]
            now = cell.clock.now()
            state.last_gap = now - 0.15, now

        cell.at_state("capture", lambda: forget(None))

    subject, cell = struck_run(tmp_path, gap)
    assert [line["step"].split()[0] for line in subject.taken_again] == ["pose"]
    kept = [line["pose"] for line in cell.notes(1, "pose taken")]
    assert len(kept) == len(set(kept)) == len(cell.poses(1)) == PLAN["poses_per_placement"]


@pytest.mark.parametrize(("device", "moment"), [("arm", "move"), ("camera", "capture")])
def test_a_cell_that_asks_after_a_lost_arm_holds_until_somebody_says_resume(
    device: str, moment: str, tmp_path: Path
) -> None:
    seen: list[str] = []

    def ask(subject: Struck) -> None:
        cell = subject.cell

        def look(run: Run) -> None:
            if cell.engine.packml is PackML.HELD:
                seen.append(cell.engine.packml.name)
                assert cell.at_rest()
                run.resume()

        silence_at(
            subject,
            device,
            moment,
            SILENT_S,
            ON_THE_WAY_S,
            lambda run: cell.plant.plants["arm"].later(8.0, lambda: look(run)),
        )

    subject, cell = struck_run(tmp_path, ask, supervisor={"ask_after_lost_arm": True})
    assert subject.end["outcome"] == "complete"
    lost = device == "arm"
    assert seen == (["HELD"] if lost else [])
    assert [line["why"] for line in cell.notes(1, "held for a person")] == (
        ["no states of arm came when its script ended: why is unknown"] if lost else []
    )
    events = [line.get("event") or line.get("packml") for line in cell.journal(1)]
    if lost:
        began = events.index("interrupted")
        assert "move_joints" not in events[began : events.index("HELD", began)]


@pytest.mark.parametrize("silent_s", [0.5, 1.5])  # over before the next step, and still on when it begins
def test_an_arm_that_is_lost_between_two_poses_is_taken_up_before_the_next_one(
    silent_s: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    genuine, poses = Interruptions.step, list[str]()

    def lose(subject: Struck) -> None:
        async def step(steps: Interruptions, what: str, work: Any) -> Any:
            if what.startswith("pose"):
                poses.append(what)
                if len(poses) == 3:
                    subject.cell.plant.plants["arm"].inject("silence", {"duration_s": silent_s})
                    await subject.cell.clock.sleep(1.0)
            return await genuine(steps, what, work)

        monkeypatch.setattr(Interruptions, "step", step)

    subject, cell = struck_run(tmp_path, lose)
    assert subject.end["outcome"] == "complete", subject.end["error"]
    assert [(line["step"], line["cause"]) for line in cell.notes(1, "interrupted")] == [
        (poses[2], "DEVICE_LOST")
    ]
    assert len(cell.poses(1)) == PLAN["poses_per_placement"]
