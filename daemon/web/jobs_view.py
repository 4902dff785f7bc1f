"""The jobs as the page's start screen lists them, what is expected of one, and where the arm is."""

import asyncio
from collections.abc import Mapping
from typing import Any

from aiohttp import web

from cell.errors import CellError, error
from daemon.engine import Engine
from daemon.job_config import make_procedure
from daemon.predictions import prediction_of
from daemon.web.answers import Visitors, json_answer

LOOKED_BACK = 500  # runs
EXPECTED_FOR_S = 30.0  # a prediction takes seconds, and nobody may keep the worker busy with them


class JobsView:
    """What is read of jobs and of the arm; nothing here starts or moves anything."""

    def __init__(self, engine: Engine, visitors: Visitors) -> None:
        self._engine, self._visitors = engine, visitors
        self._predicting = asyncio.Lock()
        self._expected: dict[str, tuple[float, dict[str, Any] | None]] = {}  # with the time when it was made

    def routes(self) -> list[web.RouteDef]:
        return [
            web.get("/api/jobs", self.jobs),
            web.get("/api/jobs/{job}/expected", self.expected),
            web.get("/api/joints", self.joints),
        ]

    async def jobs(self, request: web.Request) -> web.Response:
        """Every job with what is missing for it, and how its last runs ended."""
        self._visitors.require_look(request)
        engine = self._engine
        runs = await asyncio.to_thread(engine.ledger.runs, LOOKED_BACK)
        found = []
        for name, job in sorted(engine.jobs.items(), key=lambda entry: entry[1].number):
            own = [run for run in runs if run["job"] == name]
            obstacle = await engine.obstacle(name)
            found.append(
                {
                    "name": name,
                    "number": job.number,
                    "configured": self._configured(name),
                    "obstacle": obstacle.as_dict() if obstacle is not None else None,
                    "last": _shown(own[0]) if own else None,
                    "seconds": _seconds(own),
                }
            )
        return json_answer(found)

    def _configured(self, name: str) -> bool:
        """Whether this cell is meant to do the job: cell.toml has what it needs, and names its devices."""
        config = self._engine.context.config
        try:
            procedure = make_procedure(self._engine.jobs[name], config, {})
        except CellError:
            return name in config.job
        return set(procedure.uses()) <= config.robot.roles().keys()

    async def expected(self, request: web.Request) -> web.Response:
        """``expected``: what ``cellward check`` tells of a job, null for nothing; ``BUSY`` during a run."""
        self._visitors.require_look(request)
        engine, job = self._engine, request.match_info["job"]
        if job not in engine.jobs:
            raise error("NOT_FOUND", f"job '{job[:50]}'")
        async with self._predicting:
            now = engine.context.clock.now()
            made, answer = self._expected.get(job, (-EXPECTED_FOR_S, None))
            if now - made >= EXPECTED_FOR_S:
                if (run := engine.running) is not None:  # the worker is the run's
                    raise error("BUSY", f"{run.procedure.name}, run {run.id}")
                answer = await engine.context.worker.call(prediction_of, engine.context.config, job)
                self._expected[job] = (now, answer)
        return json_answer({"expected": answer})

    async def joints(self, request: web.Request) -> web.Response:
        """Where the arm is: joints (rad); refused while no fresh state of it is there."""
        self._visitors.require_look(request)
        return json_answer(self._engine.joints())


def _shown(run: Mapping[str, Any]) -> dict[str, Any]:
    return {key: run[key] for key in ("run_id", "started", "ended", "outcome", "verdict", "who")}


def _seconds(runs: list[dict[str, Any]]) -> float | None:
    """How long the last complete run took."""
    done = next((run for run in runs if run["outcome"] == "complete" and run["ended"]), None)
    return None if done is None else done["ended"] - done["started"]
