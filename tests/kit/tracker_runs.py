"""Runs of the tracker's job in which something goes wrong."""

import asyncio
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from fakes.object import run_virtual
from tests.kit.object_cell import ObjectCell, open_cell
from tests.kit.tracker_cell import JOB, tracker_config

Prepare = Callable[[ObjectCell], None]


def run(
    folder: Path,
    prepare: Prepare,
    job: Mapping[str, Any] | None = None,
    scenario: str = "tracker:ideal",
    **how: Any,
) -> tuple[dict[str, Any], ObjectCell]:
    """The run's ``end.json`` and its cell; ``prepare`` says what will go wrong."""

    async def main() -> tuple[dict[str, Any], ObjectCell]:
        async with open_cell(tracker_config(folder, job, scenario=scenario, **how), job=JOB) as cell:
            prepare(cell)
            return await cell.run_job(), cell

    return run_virtual(main())


def at_pose(number: int, device: str, kind: str, after_s: float = 0.0, **arguments: Any) -> Prepare:
    """The fault strikes while pose ``number`` (from 0) is measured, or ``after_s`` later."""

    def prepare(cell: ObjectCell) -> None:
        loop, seen, struck = asyncio.get_running_loop(), 0, False

        def look() -> None:
            nonlocal seen, struck
            run = cell.engine.run
            if struck or run is None or len(run.visited) == seen:
                return
            seen = len(run.visited)
            located = any(to == "monuments" for _, to in run.visited)
            if located and run.state == "measure" and run.step == number:
                struck = True
                loop.call_later(after_s, lambda: cell.plant.plants[device].inject(kind, arguments))

        cell.engine.subscribe(look)

    return prepare


def at_monuments(kind: str, **arguments: Any) -> Prepare:
    """The fault strikes when the monuments are first looked at."""

    def prepare(cell: ObjectCell) -> None:
        cell.at_state("monuments", lambda: cell.plant.plants["tracker"].inject(kind, arguments))

    return prepare


def error_of(end: Mapping[str, Any]) -> str:
    assert end["error"] is not None, end
    return str(end["error"]["name"])
