"""Everything of the API that only reads, put together."""

from collections.abc import Callable

from aiohttp import web

from cell.procedure import Worker
from daemon.engine import Engine
from daemon.log_lines import RecentLog
from daemon.plc import PlcFace
from daemon.recent_writes import RecentWrites
from daemon.web.answers import Visitors
from daemon.web.cell_view import CellView
from daemon.web.jobs_view import JobsView
from daemon.web.metrics import Metrics
from daemon.web.results_view import ResultsView
from daemon.web.runs_view import RunsView
from daemon.web.signed import RecordView
from daemon.web.trends_view import TrendsView


def views(
    engine: Engine, plc: PlcFace, writes: RecentWrites, log: RecentLog, spare: Worker
) -> Callable[[Visitors], list[web.RouteDef]]:
    """What the server takes as its further routes, once it knows its visitors. ``spare``
    computes what they ask."""

    def routes(visitors: Visitors) -> list[web.RouteDef]:
        return [
            *JobsView(engine, visitors, spare).routes(),
            *RunsView(engine, visitors).routes(),
            *RecordView(engine.runs, visitors).routes(),
            *ResultsView(engine, visitors).routes(),
            *TrendsView(engine, visitors).routes(),
            *CellView(engine, plc, writes, log, visitors).routes(),
            *Metrics(engine, visitors).routes(),
        ]

    return routes
