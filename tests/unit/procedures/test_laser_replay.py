"""A run of the crossed-beam jobs that was finished early says the same when its data are solved again."""

import asyncio
from pathlib import Path
from typing import Any

import pytest

from daemon.cli.replay import differences
from fakes.object import run_virtual
from tests.kit.laser_cell import laser_cell, laser_config
from tests.kit.laser_made import Solved, drawn_reference, solved
from tests.kit.object_cell import WHO, ObjectCell, no_report
from tests.kit.solved import solve_again

__all__ = ["no_report", "solved"]
pytestmark = pytest.mark.usefixtures("no_report")


async def finished_at(cell: ObjectCell, job: str, state: str) -> dict[str, Any]:
    """The result of a run that a person finishes the moment it enters ``state``."""
    asked: list[asyncio.Task[Any]] = []
    cell.at_state(state, lambda: asked.append(asyncio.create_task(cell.engine.finish(WHO))))
    end = await cell.run_job(job=job)
    assert len(asked) == 1
    await asked[0]
    assert (end["outcome"], end["verdict"]) == ("complete", "fail"), end
    assert cell.at_rest()
    return cell.result(1)


def replayed(cell: ObjectCell, run_id: int) -> list[Any]:
    folder, recorded = cell.folder(run_id), cell.result(run_id)
    return differences(recorded, solve_again(folder.job, folder.path, folder.info, recorded))


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


def test_a_second_scan_that_was_finished_early_replays_as_not_confirmed(
    tmp_path: Path, solved: Solved
) -> None:
    config = laser_config(tmp_path, update={"accept": {"auto": True}})

    async def main() -> None:
        async with laser_cell(config, "laser-update", drawn_reference(config)) as cell:
            result = await finished_at(cell, "laser-update", "verify")
            assert result["reasons"] == ["not confirmed: the second scan was finished early"]
            assert replayed(cell, 1) == []

    run_virtual(main())
