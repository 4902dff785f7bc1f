"""The transition table of the sampling: sound in itself, and every edge is taken by some run."""

import asyncio
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest

from cell.errors import error
from cell.motion import MotionLease
from fakes.object import VirtualClock, run_virtual
from procedures.tracker.states import CHECKPOINTS, TRANSITIONS, State
from tests.kit.object_cell import WHO, ObjectCell, open_cell
from tests.kit.tracker_cell import JOB, nominal_tracker, reflectors, tracker_config

Edge = tuple[Any, Any]
POSES = {"poses": 10}  # with fewer some of the palletizer's errors cannot be told apart
EDGES: frozenset[Edge] = frozenset((a, b) for a, to in TRANSITIONS.items() for b in to)


def test_every_state_is_reachable_and_leads_to_the_end() -> None:
    reached, front = set[State](), [None]
    while front:
        for state in TRANSITIONS[front.pop()]:
            if state not in reached:
                reached.add(state)
                front.append(state)  # type: ignore[arg-type]
    assert reached == set(State)
    assert {s for s in State if not TRANSITIONS[s]} == {State.SOLVE}


def test_a_finish_can_go_to_the_end_from_every_checkpoint() -> None:
    assert all(State.SOLVE in TRANSITIONS[c] for c in CHECKPOINTS)


def taken(cell: ObjectCell) -> set[Edge]:
    assert cell.engine.run is not None
    return set(cell.engine.run.visited)


async def walked(
    folder: Path,
    job: Mapping[str, Any] | None = None,
    prepare: Callable[[ObjectCell], Any] = lambda cell: None,
    scenario: str = "palletizer:ideal",  # its runs are quicker than those of an arm that is moved
) -> set[Edge]:
    config = tracker_config(folder, {**POSES, **(job or {})}, scenario=scenario)
    async with open_cell(config, job=JOB) as cell:
        tasks = prepare(cell)
        end = await cell.run_job()
        if tasks:
            await asyncio.wait(tasks)
        assert end["outcome"] == "complete", end
        return taken(cell)


async def lost_at_a_pose_and_at_a_monument(folder: Path) -> set[Edge]:
    def prepare(cell: ObjectCell) -> None:
        tracker = cell.plant.plants["tracker"]
        cell.at_state("monuments", lambda: tracker.inject("beam-break", {"duration_s": 2.7}))
        cell.at_state("measure", lambda: tracker.inject("beam-break", {"duration_s": 2.7}), 0.02, times=2)

    return await walked(folder, {"retries_per_pose": 4}, prepare)


async def elsewhere_than_assumed_and_refused_by_its_program(folder: Path) -> set[Edge]:
    """The tracker stands off its nominal place, so that the plan is made again; and the config has wider
    limits than the arm's own program."""
    x, *rest = nominal_tracker("palletizer")
    ranges = [[-2.9, 2.4], [0.8, 2.1], [-2.2, -0.6], [-3.0, 3.0]]
    elsewhere = {"T_base_tracker_nominal": [x + 0.08, *rest], "monuments": {}}
    return await walked(folder, {**elsewhere, "joint_ranges_rad": ranges, "request_timeout_s": 8.0})


async def carried_and_refused_by_the_guard(folder: Path) -> set[Edge]:
    """One reflector for two nests and the monuments: a person carries it to the other nest from the
    monuments, and without a look at them; the plan is made again. The guard refuses a pose that the plan held
    for free."""
    x, *rest = nominal_tracker("tracker")
    both = {"reflectors": reflectors("tracker", "smr1", "smr2"), "poses": 15, "swap_by_operator": True}
    job = {**both, "T_base_tracker_nominal": [x + 0.08, *rest], "monument_every": 7}
    genuine, moves = MotionLease.move_joints, 0

    async def moved(lease: MotionLease, q: Any, speed: Any = None) -> None:
        nonlocal moves
        moves += 1
        if moves == 9:
            raise error("MOTION_COLLISION", "a box that nobody planned with")
        await genuine(lease, q, speed)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(MotionLease, "move_joints", moved)
        return await walked(folder, job, scenario="tracker:ideal")


async def shaken(folder: Path) -> set[Edge]:
    """A pose that shakes is settled again, and given up."""

    def prepare(cell: ObjectCell) -> None:
        shake = {"m": 0.002, "duration_s": 4.0}
        cell.at_state("settle", lambda: cell.plant.plants["tracker"].inject("vibration", shake))

    return await walked(folder, {"measure_timeout_s": 1.0, "retries_per_pose": 1}, prepare)


async def finished_early(folder: Path) -> set[Edge]:
    """Without monuments that would have to be looked at first."""

    def prepare(cell: ObjectCell) -> list[asyncio.Task[None]]:
        tasks: list[asyncio.Task[None]] = []

        def look() -> None:
            if not tasks and cell.engine.status()["step"] >= 3:
                tasks.append(asyncio.create_task(cell.engine.finish(WHO)))

        cell.engine.subscribe(look)
        return tasks

    return await walked(folder, {"monuments": {}}, prepare)


async def adopted(folder: Path) -> set[Edge]:
    clock = VirtualClock()
    config = tracker_config(folder, {**POSES, "monument_every": 4}, scenario="palletizer:ideal")
    async with open_cell(config, clock, job=JOB) as cell:
        await cell.run_job()
        await cell.run_job(adopt=1)
        return taken(cell)


WALKS = (
    lost_at_a_pose_and_at_a_monument,
    elsewhere_than_assumed_and_refused_by_its_program,
    carried_and_refused_by_the_guard,
    shaken,
    finished_early,
    adopted,
)


@pytest.fixture(scope="module")
def all_taken(tmp_path_factory: pytest.TempPathFactory) -> Iterator[set[Edge]]:
    """The edges that a handful of runs take together."""
    patch = pytest.MonkeyPatch()

    async def drawn(run: Any) -> None: ...

    patch.setattr("daemon.results._write_report", drawn)
    edges: set[Edge] = set()
    for number, walk in enumerate(WALKS):
        edges |= run_virtual(walk(tmp_path_factory.mktemp(f"walk{number}")))
    yield edges
    patch.undo()


def test_every_edge_of_the_table_is_taken(all_taken: set[Edge]) -> None:
    assert EDGES - all_taken == set()
