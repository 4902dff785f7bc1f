"""Results as the page shows them: what waits, what is in effect, and what a decision changes."""

import asyncio
from collections.abc import Mapping
from typing import Any

from aiohttp import web

from cell.errors import CellError
from cell.store.runs import load_run
from cell.store.summary import whole_result
from daemon.decisions import use_of, warnings_of
from daemon.engine import Engine
from daemon.values import tell_configured
from daemon.web.answers import Visitors, json_answer
from daemon.words.result_text import result_text
from daemon.words.value_text import in_a_list, value_text
from procedures.kind import KINDS

MOST_RESULTS = 200
COMPARED = {name for kind in KINDS.values() if kind.compare for name in kind.measures}


class ResultsView:
    """What is read of the ledger, in threads."""

    def __init__(self, engine: Engine, visitors: Visitors) -> None:
        self._engine, self._visitors = engine, visitors

    def routes(self) -> list[web.RouteDef]:
        return [
            web.get("/api/results", self.results),
            web.get(r"/api/results/{result:\d{1,10}}", self.result),
        ]

    async def results(self, request: web.Request) -> web.Response:
        """Every result of the ledger, newest first, its value in words."""
        self._visitors.require_look(request)
        return json_answer(await asyncio.to_thread(self._list))

    def _list(self) -> list[dict[str, Any]]:
        tell_configured(self._engine.context.config, self._engine.ledger)
        found = []
        for entry in self._engine.ledger.results(limit=MOST_RESULTS):
            kept = {k: v for k, v in in_a_list(entry).items() if k not in ("config_value", "folder", "value")}
            compared = entry["name"].partition(".")[0] in COMPARED
            found.append({**kept, "words": value_text(entry["name"], entry["value"]), "compared": compared})
        return found

    async def result(self, request: web.Request) -> web.Response:
        """One result with what was before it, and in words what accepting it would change."""
        self._visitors.require_look(request)
        number = int(request.match_info["result"])
        return json_answer(await asyncio.to_thread(self._one, number))

    def _one(self, number: int) -> dict[str, Any]:
        ledger, config = self._engine.ledger, self._engine.context.config
        tell_configured(config, ledger)
        row = ledger.result(number)
        before = ledger.in_effect(row["name"])
        if before is not None and before["id"] == row["id"]:
            before = None  # what it replaced is the configured value, or an earlier version
        value_before = before["value"] if before is not None else row["config_value"]
        shown = {key: row[key] for key in ("id", "name", "state", "version", "run_id", "proposed", "decided")}
        whole = whole_result(row, self._engine.runs) or row["result"] or {}
        return {
            **shown,
            "who": row["who"],
            "why": row["why"],
            "verdict": whole.get("verdict"),
            "reasons": whole.get("reasons") or [],
            "warnings": warnings_of(row),
            "words": _words(whole),
            "now": _value(row["name"], row["value"]),
            "before": _value(row["name"], value_before),
            "before_version": before["version"] if before is not None else None,
            "use": use_of(config, row["name"], row["version"] or "of this result"),
            "figures": _figures(whole, self._limits(row)),
        }

    def _limits(self, row: Mapping[str, Any]) -> Mapping[str, Any]:
        """The limits of acceptance that the run was started with."""
        try:
            job = load_run(self._engine.runs, row["run_id"]).info.get("job_config") or {}
        except CellError:
            return {}
        accept = job.get("accept")
        return accept if isinstance(accept, Mapping) else {}


def _value(name: str, value: Any) -> dict[str, Any]:
    """In words, and a pose as its six numbers too, so that the change can be shown."""
    pose = value if isinstance(value, list) and len(value) == 6 else None
    return {"words": value_text(name, value), "pose": pose}


def _words(result: Mapping[str, Any]) -> str:
    try:
        return result_text(result) if result else ""
    except CellError as exc:
        return str(exc)


def _figures(result: Mapping[str, Any], limits: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Uncertainties (95 %) beside the limits that the run held them against."""
    inside = result.get("uncertainty") or {}
    pairs = (("error95_t_m", "max_error_t_m"), ("error95_r_rad", "max_error_r_rad"))
    return [
        {"name": name, "value": inside[name], "limit": limits.get(limit)}
        for name, limit in pairs
        if isinstance(inside.get(name), int | float)
    ]
