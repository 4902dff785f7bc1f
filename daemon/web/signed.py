"""The record of a run as somebody signs it on the page: its digest, and who has signed it so far."""

import asyncio
from pathlib import Path
from typing import Any

from aiohttp import web

from cell.errors import error
from cell.store.fingerprint import fingerprint_as_last_seen
from cell.store.runs import load_run
from cell.store.signatures import Checked, check_signatures
from daemon.web.answers import Visitors, json_answer

TOLD = ("at", "name", "role", "remark", "user", "digest")


class RecordView:
    """Reads every file of a run, in a thread; signing itself is a request to the engine."""

    def __init__(self, runs: Path, visitors: Visitors) -> None:
        self._runs, self._visitors = runs, visitors

    def routes(self) -> list[web.RouteDef]:
        return [web.get(r"/api/runs/{run:\d{1,10}}/record", self.record)]

    async def record(self, request: web.Request) -> web.Response:
        """``digest`` and number of ``files`` that a signature would be for, and the ``signatures``."""
        self._visitors.require_look(request)
        return json_answer(await asyncio.to_thread(self._record, int(request.match_info["run"])))

    def _record(self, number: int) -> dict[str, Any]:
        run = load_run(self._runs, number)
        if run.read_end() is None:
            raise error("NOT_NOW", f"run {number} ({run.job}) has not ended; it can be signed after its end")
        found = fingerprint_as_last_seen(run.path)
        return {
            "digest": found.digest,
            "files": len(found.record.sums),
            "signatures": [told(checked) for checked in check_signatures(run.path, found)],
        }


def told(checked: Checked) -> dict[str, Any]:
    """A signature without the sums of its files; ``name`` is null of a file that cannot be read."""
    by = checked.signature
    return {**{key: getattr(by, key, None) for key in TOLD}, "changed": checked.changed}
