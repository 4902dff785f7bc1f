"""The transition tables of the crossed-beam jobs: sound in themselves, and every edge taken by some run."""

import asyncio
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from daemon.config import CellConfig
from fakes.object import run_virtual
from procedures.laser.states import CHECKPOINTS, SCAN, ScanState
from procedures.laser.update import LaserUpdate
from procedures.laser.update import State as UpdateState
from tests.kit.laser_cell import laser_cell, laser_config
from tests.kit.laser_made import Solved, answer_at_once, drawn_reference
from tests.kit.object_cell import WHO, ObjectCell, no_report

__all__ = ["no_report"]
pytestmark = pytest.mark.usefixtures("no_report")

Edge = tuple[Any, Any]


def edges_of(table: Any) -> set[Edge]:
    return {(a and str(a), str(b)) for a, to in table.items() for b in to}


@pytest.mark.parametrize(
    ("table", "states", "ends"),
    [(SCAN, ScanState, {"solve"}), (LaserUpdate.TRANSITIONS, UpdateState, {"commit", "reject"})],
    ids=["scan", "update"],
)
def test_every_state_is_reachable_and_leads_to_the_end(table: Any, states: Any, ends: set[str]) -> None:
    reached, front = set[Any](), [None]
    while front:
        for state in table[front.pop()]:
            if state not in reached:
                reached.add(state)
                front.append(state)
    assert {str(s) for s in reached} == {s.value for s in states}
    assert {str(s) for s in states if not table[s]} == ends


def test_a_finish_leads_to_the_end_from_every_checkpoint() -> None:
    for checkpoint in CHECKPOINTS:
        assert SCAN[checkpoint] & {ScanState.LIFT, ScanState.RETRACT}
    assert ScanState.RETRACT in SCAN[ScanState.LIFT]


def taken(cell: ObjectCell) -> set[Edge]:
    assert cell.engine.run is not None
    return {(a and a.value, b.value) for a, b in cell.engine.run.visited}


def asked_at(cell: ObjectCell, state: str, what: Any, times: int = 1) -> list[asyncio.Task[Any]]:
    """Ask the engine for something the moment the job enters ``state``."""
    tasks: list[asyncio.Task[Any]] = []
    cell.at_state(state, lambda: tasks.append(asyncio.create_task(what())), times=times)
    return tasks


async def walked(config: CellConfig, job: str, outcome: tuple[str, str], prepare: Any = None) -> set[Edge]:
    """Run the job to its end, which must be ``outcome``."""
    async with laser_cell(config, job, drawn_reference(config)) as cell:
        tasks = prepare(cell) if prepare is not None else None
        end = await cell.run_job()
        if tasks:
            await asyncio.wait(tasks)
        assert (end["outcome"], end["verdict"] or end["error"]["name"]) == outcome, end
        assert cell.at_rest()
        return taken(cell)


async def committed(folder: Path, solved: Solved) -> set[Edge]:
    config = laser_config(folder, update={"accept": {"auto": True}})
    return await walked(config, "laser-update", ("complete", "pass"))


async def longer_tool(folder: Path, solved: Solved) -> set[Edge]:
    """Met at the first sweep, so it is lifted until it is not."""

    def bend(cell: ObjectCell) -> None:
        cell.plant.world.tool.bend(cell.clock.now(), [0.0, 0.0, 0.009])

    return await walked(laser_config(folder), "laser-check", ("complete", "fail"), bend)


async def gap_between_polls(folder: Path, solved: Solved) -> set[Edge]:
    """The first pair of ways is taken again at once."""

    def gap(cell: ObjectCell) -> None:
        cell.at_state("sweep", lambda: cell.plant.inputs.inject("gap", {"count": 12}), 0.05)

    return await walked(laser_config(folder), "laser-check", ("complete", "fail"), gap)


def finished_at(state: str) -> Any:
    async def walk(folder: Path, solved: Solved) -> set[Edge]:
        def prepare(cell: ObjectCell) -> Any:
            return asked_at(cell, state, lambda: cell.engine.finish(WHO))

        return await walked(laser_config(folder), "laser-check", ("complete", "fail"), prepare)

    return walk


async def asked_and_finished(folder: Path, solved: Solved) -> set[Edge]:
    def prepare(cell: ObjectCell) -> Any:
        return asked_at(cell, "ask", lambda: cell.engine.finish(WHO))

    return await walked(laser_config(folder), "laser-update", ("complete", "fail"), prepare)


async def confirmed_and_not_met(folder: Path, solved: Solved) -> set[Edge]:
    solved.meets = False
    return await walked(laser_config(folder), "laser-update", ("complete", "fail"))


async def missed_narrowly(folder: Path, solved: Solved) -> set[Edge]:
    """The second scan is taken once more, and both together meet."""
    solved.misses = [1.5, 0.5]
    config = laser_config(folder, update={"accept": {"auto": True}})
    return await walked(config, "laser-update", ("complete", "pass"))


WALKS = (
    committed,
    missed_narrowly,
    longer_tool,
    gap_between_polls,
    finished_at("plan"),
    finished_at("approach"),
    asked_and_finished,
    confirmed_and_not_met,
)


@pytest.fixture(scope="module")
def all_taken(tmp_path_factory: pytest.TempPathFactory) -> Iterator[set[Edge]]:
    """The edges that a handful of runs take together."""
    patch = pytest.MonkeyPatch()

    async def drawn(run: Any) -> None: ...

    patch.setattr("daemon.results._write_report", drawn)
    edges: set[Edge] = set()
    for number, walk in enumerate(WALKS):
        solved = answer_at_once(patch)
        edges |= run_virtual(walk(tmp_path_factory.mktemp(f"walk{number}"), solved))
    yield edges
    patch.undo()


def test_every_edge_of_the_tables_is_taken(all_taken: set[Edge]) -> None:
    assert (edges_of(SCAN) | edges_of(LaserUpdate.TRANSITIONS)) - all_taken == set()
