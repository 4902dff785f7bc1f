"""The transition table of the capture job: sound in itself, and every edge is taken by some run."""

import asyncio
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from cell.errors import error
from cell.motion import MotionLease
from fakes.object import VirtualClock, run_virtual
from procedures.hand_eye.cone_capture import ConeCapture
from procedures.hand_eye.states import State
from tests.kit.hand_eye_made import solve_quickly
from tests.kit.object_cell import WHO, ObjectCell, no_report, open_cell, write_config

__all__ = ["no_report"]
pytestmark = pytest.mark.usefixtures("no_report")

Edge = tuple[State | None, State]
EDGES: frozenset[Edge] = frozenset((a, b) for a, to in ConeCapture.TRANSITIONS.items() for b in to)


def taken(cell: ObjectCell) -> set[Edge]:
    assert cell.engine.run is not None
    return set(cell.engine.run.visited)  # type: ignore[arg-type]


def test_every_state_is_reachable_and_leads_to_the_end() -> None:
    reached, front = set[State](), [None]
    while front:
        for state in ConeCapture.TRANSITIONS[front.pop()]:
            if state not in reached:
                reached.add(state)
                front.append(state)  # type: ignore[arg-type]
    assert reached == set(State)
    ends = {s for s in State if not ConeCapture.TRANSITIONS[s]}
    assert ends == {State.SOLVE}


def test_a_finish_can_go_to_the_end_from_every_checkpoint() -> None:
    assert all(State.SOLVE in ConeCapture.TRANSITIONS[c] for c in ConeCapture.CHECKPOINTS)


@pytest.fixture(scope="module")
def all_taken(tmp_path_factory: pytest.TempPathFactory) -> Iterator[set[Edge]]:
    """The edges that a handful of runs take together."""
    patch = pytest.MonkeyPatch()

    async def drawn(run: Any) -> None: ...

    patch.setattr("daemon.results._write_report", drawn)
    solve_quickly(patch)
    edges: set[Edge] = set()
    for number, walk in enumerate(WALKS):
        edges |= run_virtual(walk(tmp_path_factory.mktemp(f"walk{number}")))
    yield edges
    patch.undo()


async def a_pose_again(folder: Path) -> set[Edge]:
    async with open_cell(write_config(folder, job={"poses_per_placement": 3})) as cell:
        operator = cell.plant.world.operator

        def hide() -> None:
            operator.remove(cell.clock.now())
            asyncio.get_running_loop().call_later(0.5, lambda: operator.put_back(cell.clock.now()))

        cell.at_state("settle", hide)
        await cell.run_job()
        return taken(cell)


def finished_at(state: str) -> Any:
    async def walk(folder: Path) -> set[Edge]:
        async with open_cell(write_config(folder, job={"poses_per_placement": 3})) as cell:
            asked: list[asyncio.Task[None]] = []

            def ask() -> None:
                asked.append(asyncio.create_task(cell.engine.finish(WHO)))

            before = {"place": "prepare", "seek": "start-pose", "move": "plan"}[state]
            cell.at_state(before, ask)
            await cell.run_job()
            await asyncio.wait(asked)
            return taken(cell)

    return walk


async def poses_that_the_guard_forbids(folder: Path) -> set[Edge]:
    """The guard forbids the second and the last pose, although the plan held them for free."""
    async with open_cell(write_config(folder, job={"poses_per_placement": 6})) as cell:
        genuine = MotionLease.move_joints
        moves = 0

        async def moved(lease: MotionLease, q: Any, speed: Any = None) -> None:
            nonlocal moves
            run = cell.engine.run
            if run is not None and run.state is State.MOVE:
                moves += 1
                if moves in (2, 6):
                    raise error("MOTION_COLLISION", "a box that nobody planned with")
            await genuine(lease, q, speed)

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(MotionLease, "move_joints", moved)
            end = await cell.run_job()
        assert end["outcome"] == "complete"
        assert [n["why"].split(":")[0] for n in cell.notes(1, "pose skipped")] == [
            "A move would leave the workspace or enter a keep-out box"
        ] * 2
        return taken(cell)


async def adopted_at_every_point(folder: Path) -> set[Edge]:
    """Adopting after the last pose of a placement, after the board was moved, and after everything."""
    clock, edges = VirtualClock(), set[Edge]()
    config = write_config(folder, job={"placements": 2, "poses_per_placement": 3})
    async with open_cell(config, clock) as cell:
        stops: list[asyncio.Task[None]] = []
        cell.at_state("return", lambda: stops.append(asyncio.create_task(cell.engine.abort(WHO))))
        assert (await cell.run_job())["outcome"] == "stopped"
        await asyncio.wait(stops)
        complete = await cell.run_job()
        assert complete["outcome"] == "complete"
        await cell.run_job(adopt=2)
        edges |= taken(cell)
        await cell.run_job(adopt=1)
        edges |= taken(cell)
        cell.plant.world.operator.move_on(clock.now())
        await cell.run_job(adopt=1)
        return edges | taken(cell)


async def placed_again_after(folder: Path, job: dict[str, Any], spoil: Any) -> set[Edge]:
    """``spoil`` the first try of the only placement; the operator puts it right when the job asks."""
    async with open_cell(write_config(folder, job={"poses_per_placement": 3, **job})) as cell:
        spoil(cell)
        run_id = await cell.start(placed=False)
        for _ in range(2):
            await cell.until(lambda: cell.engine.run is not None and cell.engine.run.prompt, "a prompt")
            prompt = cell.engine.status()["prompt"]
            if "Placement 1 of 1: put" not in prompt["text"]:
                cell.plant.world.operator.put_back(cell.clock.now())
            await cell.engine.confirm(prompt["id"], WHO)
        assert (await cell.finished(run_id))["outcome"] == "complete"
        return taken(cell)


async def badly_placed(folder: Path) -> set[Edge]:
    """The operator hears that most poses are lost, and leaves the board where it is."""

    def farther(cell: ObjectCell) -> None:
        mounts = cell.plant.world.T_mount_target
        outward = mounts[0].translation * [1.0, 1.0, 0.0]
        mounts[0] = RigidTransform.from_translation(0.1 * outward / np.linalg.norm(outward)) * mounts[0]

    return await placed_again_after(folder, {"poses_per_placement": 12, "distance_m": 1.55}, farther)


async def board_taken_away_at_its_second_pose(folder: Path) -> set[Edge]:
    def take_away(cell: ObjectCell) -> None:
        cell.at_state("move", lambda: cell.plant.world.operator.remove(cell.clock.now()))

    return await placed_again_after(folder, {"retries_per_pose": 0}, take_away)


async def one_placement_skipped(folder: Path) -> set[Edge]:
    async with open_cell(write_config(folder, job={"placements": 2, "poses_per_placement": 3})) as cell:
        run_id = await cell.start(placed=False)
        await cell.until(lambda: cell.engine.status()["prompt"], "a prompt")
        await cell.engine.skip(cell.engine.status()["prompt"]["id"], WHO)
        assert (await cell.finished(run_id))["outcome"] == "complete"
        return taken(cell)


async def lost_in_the_search(folder: Path) -> set[Edge]:
    config = write_config(folder, job={"poses_per_placement": 3, "seek_timeout_s": 1.0})
    robot = config.robot.model_copy(update={"T_flange_camera_nominal": None})
    async with open_cell(config.model_copy(update={"robot": robot})) as cell:
        operator = cell.plant.world.operator
        cell.at_state("move", lambda: operator.remove(cell.clock.now()))
        run_id = await cell.start(placed=False)
        for _ in range(2):
            await cell.until(lambda: cell.engine.run is not None and cell.engine.run.prompt, "a prompt")
            operator.put_back(cell.clock.now())
            await cell.engine.confirm(cell.engine.status()["prompt"]["id"], WHO)
        assert (await cell.finished(run_id))["outcome"] == "complete"
        return taken(cell)


WALKS = (
    a_pose_again,
    finished_at("place"),
    finished_at("seek"),
    finished_at("move"),
    poses_that_the_guard_forbids,
    adopted_at_every_point,
    badly_placed,
    board_taken_away_at_its_second_pose,
    lost_in_the_search,
    one_placement_skipped,
)


def test_every_edge_of_the_table_is_taken(all_taken: set[Edge]) -> None:
    assert EDGES - all_taken == set()
