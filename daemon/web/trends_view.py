"""Trends as the page shows them: health numbers over the runs with their limits, and when checks are due."""

import asyncio
from contextlib import suppress
from functools import reduce
from typing import Any

from aiohttp import web

from cell.errors import CellError
from daemon.check_due import CheckDue
from daemon.engine import Engine
from daemon.job_config import make_procedure
from daemon.web.answers import Visitors, json_answer
from procedures.documents import kind_named

TREND_POINTS = 200


class TrendsView:
    """What is read of the ledger, in threads."""

    def __init__(self, engine: Engine, visitors: Visitors) -> None:
        self._engine, self._visitors = engine, visitors
        context = engine.context
        self._checks = CheckDue(context.config, engine.ledger, engine.jobs, context.clock)

    def routes(self) -> list[web.RouteDef]:
        return [web.get("/api/trends", self.trends)]

    async def trends(self, request: web.Request) -> web.Response:
        """``trends`` by name, in SI units, and ``checks``: the outlook of :class:`CheckDue`.

        Of a trend the newest ``points``, [wall time in s, value], and the ``limit`` of their size with the
        ``key`` of the configuration that sets it.
        """
        self._visitors.require_look(request)
        return json_answer(await asyncio.to_thread(self._read))

    def _read(self) -> dict[str, Any]:
        ledger, limits = self._engine.ledger, self._limits()
        trends = {}
        for name in ledger.trend_names():
            limit, key = next((limits[of] for of in limits if name.startswith(f"{of}.")), (None, None))
            trends[name] = {"points": ledger.trend(name, TREND_POINTS), "limit": limit, "key": key}
        return {"trends": trends, "checks": self._checks.outlook()}

    def _limits(self) -> dict[str, tuple[float, str]]:
        """By trend, without the names that it ends with: the smallest limit of the jobs that leave it."""
        found: dict[str, tuple[float, str]] = {}
        for name, job in self._engine.jobs.items():
            kind = kind_named(job.kind, "job") if job.kind else None
            with suppress(CellError):  # a job that this cell has no section for bounds nothing
                config = make_procedure(job, self._engine.context.config, {}).config
                for trend, key in kind.trend_limits if kind else ():
                    limit = reduce(getattr, key.split("."), config)
                    if limit is not None and (trend not in found or limit < found[trend][0]):
                        found[trend] = limit, f"[job.{name}] {key}"
        return found
