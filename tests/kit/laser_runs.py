"""What the tests of checks and updates share: the job, a run solved again, an act at a state."""

import asyncio
from collections.abc import Callable
from typing import Any

from daemon.cli.replay import differences
from tests.kit.object_cell import ObjectCell
from tests.kit.solved import solve_again

JOB = "laser-update"
AUTO = {"accept": {"auto": True}}


def replayed(cell: ObjectCell, run_id: int) -> list[Any]:
    """What differs when the run's data are solved again."""
    folder, recorded = cell.folder(run_id), cell.result(run_id)
    return differences(recorded, solve_again(folder.job, folder.path, folder.info, recorded))


def asked(cell: ObjectCell, state: str, what: Callable[[], Any]) -> list[Any]:
    tasks: list[asyncio.Task[Any]] = []
    cell.at_state(state, lambda: tasks.append(asyncio.create_task(what())))
    return tasks
