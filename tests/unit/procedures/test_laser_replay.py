"""A run of the crossed-beam jobs that was finished early says the same when its data are solved again."""

import asyncio
from itertools import count
from pathlib import Path
from typing import Any

import pytest

from fakes.object import run_virtual
from tests.kit.laser_cell import laser_cell, laser_config
from tests.kit.laser_made import Solved, drawn_reference, solved
from tests.kit.laser_runs import AUTO, JOB, replayed
from tests.kit.object_cell import WHO, ObjectCell, no_report

__all__ = ["no_report", "solved"]
pytestmark = pytest.mark.usefixtures("no_report")

NARROWLY = [1.5, 0.8]  # by which the second scan misses, and both together do not


async def finished_at(cell: ObjectCell, job: str, state: str, visit: int = 1) -> dict[str, Any]:
    """The result of a run that a person finishes the moment it enters ``state`` for this ``visit``."""
    tasks: list[asyncio.Task[Any]] = []
    visits = count(1)

    def enters() -> None:
        if next(visits) == visit:
            tasks.append(asyncio.create_task(cell.engine.finish(WHO)))

    cell.at_state(state, enters, times=visit)
    end = await cell.run_job(job=job)
    assert len(tasks) == 1
    await tasks[0]
    assert (end["outcome"], end["verdict"]) == ("complete", "fail"), end
    assert cell.at_rest()
    return cell.result(1)


@pytest.mark.parametrize("job", ["laser-reference", "laser-check", "laser-update"])
@pytest.mark.parametrize(("state", "ways"), [("plan", 0), ("descend", 2)])
def test_a_scan_that_was_finished_early_replays_as_just_that(
    job: str, state: str, ways: int, tmp_path: Path
) -> None:
    config = laser_config(tmp_path)

    async def main() -> None:
        async with laser_cell(config, job, drawn_reference(config)) as cell:
            result = await finished_at(cell, job, state)
            assert result["result"] is None
            assert result["reasons"] == [
                f"finished-early: {ways} ways were taken, and both beams must be measured to the end"
            ]
            assert replayed(cell, 1) == []

    run_virtual(main())


@pytest.mark.parametrize(("visit", "scan"), [(1, "second"), (2, "third")])
def test_a_scan_with_the_candidate_that_was_finished_early_replays_as_not_confirmed(
    visit: int, scan: str, tmp_path: Path, solved: Solved
) -> None:
    solved.misses = NARROWLY
    config = laser_config(tmp_path, update=AUTO)

    async def main() -> None:
        async with laser_cell(config, JOB, drawn_reference(config)) as cell:
            result = await finished_at(cell, JOB, "verify", visit)
            assert result["reasons"] == [f"not confirmed: the {scan} scan was finished early"]
            assert replayed(cell, 1) == []

    run_virtual(main())


def test_a_third_scan_that_decided_is_compared_when_the_run_is_solved_again(
    tmp_path: Path, solved: Solved
) -> None:
    solved.misses = NARROWLY
    config = laser_config(tmp_path, update=AUTO)

    async def main() -> None:
        async with laser_cell(config, JOB, drawn_reference(config)) as cell:
            await cell.run_job()
            assert cell.result(1)["verdict"] == "pass"
            assert replayed(cell, 1) == []
            solved.misses = [1.5, 1.2]
            assert [d["where"] for d in replayed(cell, 1)] == ["verdict", "reasons"]

    run_virtual(main())
