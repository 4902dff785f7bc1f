"""The jobs as the page's start screen lists them, what is expected of one, and where the arm is."""

import asyncio
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any

from aiohttp import web

from cell.errors import CellError, error
from cell.procedure import Worker
from cell.store.runs import ALTERED, altered_in
from daemon.engine import Engine
from daemon.job_config import make_procedure
from daemon.predictions import prediction_of
from daemon.startable import Startable, startables
from daemon.tools import ARGUMENT, asked_tool, tool_names
from daemon.web.answers import Visitors, json_answer

LOOKED_BACK = 500  # runs
EXPECTED_FOR_S = 30.0  # a prediction takes seconds, and nobody may keep a core busy with them

TOO_LATE = "This computer is too busy to predict now; 'cellward check' has more time."


class JobsView:
    """What is read of jobs and of the arm; nothing here starts or moves anything.

    ``spare`` predicts: the engine's worker plans and solves, and nobody who looks at the page may delay that.
    """

    def __init__(self, engine: Engine, visitors: Visitors, spare: Worker) -> None:
        self._engine, self._visitors, self._spare = engine, visitors, spare
        self._predicting = asyncio.Lock()
        # by job and tool, with the time when it was made
        self._expected: dict[tuple[str, str | None], tuple[float, dict[str, Any] | None]] = {}

    def routes(self) -> list[web.RouteDef]:
        return [
            web.get("/api/jobs", self.jobs),
            web.get("/api/jobs/{job}/expected", self.expected),
            web.get("/api/joints", self.joints),
        ]

    async def jobs(self, request: web.Request) -> web.Response:
        """Every job and recipe with what is missing for it, and how the last runs of the job ended."""
        self._visitors.require_look(request)
        engine = self._engine
        runs = await asyncio.to_thread(engine.ledger.runs, LOOKED_BACK)
        newest = await asyncio.to_thread(_newest, runs, engine.runs)
        found = []
        for one in startables(engine.context.config, engine.jobs):
            own = [run for run in runs if run["job"] == one.job]
            obstacle = await self._obstacle(one)
            found.append(
                {
                    **asdict(one),
                    "configured": one.recipe or self._configured(one.job),
                    "obstacle": obstacle.as_dict() if obstacle is not None else None,
                    "last": newest.get(one.job),
                    "seconds": _seconds(own),
                }
            )
        return json_answer(found)

    async def _obstacle(self, one: Startable) -> CellError | None:
        """Why it cannot be started; with no tool where a start has to name one."""
        if one.tool is not None or not one.tools:
            return await self._engine.needs.obstacle(one.name)
        found = [await self._engine.needs.obstacle(one.name, tool) for tool in one.tools]
        return None if None in found else found[0]

    def _configured(self, name: str) -> bool:
        """Whether this cell is meant to do the job: cell.toml has what it needs, and names its devices."""
        config = self._engine.context.config
        try:
            procedure = make_procedure(self._engine.jobs[name], config, {})
        except CellError:
            return name in config.job
        return set(procedure.uses()) <= config.robot.roles().keys()

    async def expected(self, request: web.Request) -> web.Response:
        """``expected``: what ``cellward check`` tells of a job or recipe with the ``tool`` of the query, null
        for nothing; ``BUSY`` during a run."""
        self._visitors.require_look(request)
        engine, name = self._engine, request.match_info["job"]
        config, asked = engine.context.config, request.query.get("tool")
        recipe = config.recipe.get(name)
        job = name if recipe is None else recipe.job
        if job not in engine.jobs:
            raise error("NOT_FOUND", f"job '{job[:50]}'")
        if asked is None and recipe is not None:
            asked = recipe.parameters.get(ARGUMENT)
        tool = asked_tool(config, job, asked, needed=len(tool_names(config)) > 1)
        key = name, None if tool is None else tool.name
        async with self._predicting:
            now = engine.context.clock.now()
            made, answer = self._expected.get(key, (-EXPECTED_FOR_S, None))
            if now - made >= EXPECTED_FOR_S:
                if (run := engine.running) is not None:  # the cores are the run's
                    raise error("BUSY", f"{run.procedure.name}, run {run.id}")
                try:
                    answer = await self._spare.call(prediction_of, config, *key)
                except TimeoutError:
                    answer = {"job": job, "text": "no prediction", "limits": [], "cautions": [TOO_LATE]}
                self._expected[key] = (now, answer)
        return json_answer({"expected": answer})

    async def joints(self, request: web.Request) -> web.Response:
        """Where the arm is: joints (rad); refused while no fresh state of it is there."""
        self._visitors.require_look(request)
        return json_answer(self._engine.joints())


def _newest(runs: list[dict[str, Any]], folders: Path) -> dict[str, dict[str, Any]]:
    """The newest of ``runs`` of each job, with the verdict that its own files have now."""
    found: dict[str, dict[str, Any]] = {}
    for run in runs:
        if run["job"] not in found:
            shown = {key: run[key] for key in ("run_id", "started", "ended", "outcome", "verdict", "who")}
            with suppress(CellError):  # a folder that is gone: the ledger's own word
                if run["folder"] and altered_in(folders / run["folder"]):
                    shown["verdict"] = ALTERED
            found[run["job"]] = shown
    return found


def _seconds(runs: list[dict[str, Any]]) -> float | None:
    """How long the last complete run took."""
    done = next((run for run in runs if run["outcome"] == "complete" and run["ended"]), None)
    return None if done is None else done["ended"] - done["started"]
