"""Runs as the page shows them: the list, one with journal and result in words, its report, its pictures."""

import asyncio
import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from aiohttp import web

from cell.errors import CellError, error
from cell.store.run_fields import tool_on_flange
from cell.store.run_list import ListedRun, listed_runs
from cell.store.runs import ALTERED, RunFolder, load_run
from daemon.engine import Engine
from daemon.web.answers import Visitors, json_answer
from daemon.web.origin import REPORT_POLICY
from daemon.web.signed import told
from daemon.words.journal_text import timeline
from daemon.words.result_text import result_text
from procedures.comparison import compare_results
from procedures.documents import kind_named
from procedures.registry import JOBS
from procedures.report.source import hides_altered

MOST_RUNS = 200
JOURNAL_LINES = 400
TAIL_BYTES = 256 * 1024
LONGEST_RESULT = 8_000_000  # bytes, of one that is told in words
LONGEST_REPORT = 64_000_000


class RunsView:
    """What is read of run folders, in threads: the disk never holds up the loop."""

    def __init__(self, engine: Engine, visitors: Visitors) -> None:
        self._engine, self._visitors = engine, visitors

    def routes(self) -> list[web.RouteDef]:
        return [
            web.get("/api/runs", self.runs),
            web.get(r"/api/runs/{run:\d{1,10}}", self.run),
            web.get(r"/api/runs/{run:\d{1,10}}/against/{first:\d{1,10}}", self.against),
            web.get(r"/api/runs/{run:\d{1,10}}/report", self.report),
            web.get(r"/api/runs/{run:\d{1,10}}/seen", self.seen),
            web.get(r"/api/runs/{run:\d{1,10}}/picture/{name}", self.picture),
        ]

    async def runs(self, request: web.Request) -> web.Response:
        """The newest runs as the index of reports has them."""
        self._visitors.require_look(request)
        return json_answer(await asyncio.to_thread(self._list))

    def _list(self) -> list[dict[str, Any]]:
        found = listed_runs(self._engine.runs, self._engine.ledger, MOST_RUNS)
        return [
            {**asdict(run), "signatures": [told(s) for s in run.signatures], "compared_as": _compared_as(run)}
            for run in found
        ]

    async def run(self, request: web.Request) -> web.Response:
        self._visitors.require_look(request)
        return json_answer(await asyncio.to_thread(self._one, self._number(request)))

    def _one(self, number: int) -> dict[str, Any]:
        folder = load_run(self._engine.runs, number)
        end = _read(folder, "end.json") or {}
        row = _row(folder, end)
        journal = folder.read_journal()
        shown = {
            **row,
            "error": end.get("error"),
            "parameters": folder.info.get("parameters") or {},
            "recipe": folder.info.get("recipe"),
            "tool": tool_on_flange(folder.info),
            "journal": timeline(_newest(journal)),
            "result": self._result(folder, row["verdict"]),
            "report": (folder.path / "report.html").exists(),
        }
        running = self._engine.running
        return {**shown, "running": running is not None and running.id == number}

    def _result(self, folder: RunFolder, verdict: str | None) -> dict[str, Any] | None:
        """``verdict`` is the one that the run is listed with."""
        path = folder.path / "result.json"
        if not path.exists() or path.stat().st_size > LONGEST_RESULT:
            return None
        result = folder.read_result()
        if result is None:
            return None
        kept = {key: result.get(key) for key in ("kind", "verdict", "reasons", "warnings", "heldout")}
        if verdict == ALTERED:
            kept["verdict"] = ALTERED
        try:
            words = result_text(result, str(path))
        except CellError as exc:
            words = str(exc)
        waiting = [entry for entry in self._engine.decisions.waiting if entry["run_id"] == folder.run_id]
        return {**kept, "words": words, "waiting": waiting}

    async def against(self, request: web.Request) -> web.Response:
        """The result of a run against that of an earlier one, as ``cellward compare`` tells it."""
        self._visitors.require_look(request)
        first = int(request.match_info["first"])
        return json_answer(await asyncio.to_thread(self._against, first, self._number(request)))

    def _against(self, first: int, second: int) -> dict[str, Any]:
        found = compare_results(*(_result_of(load_run(self._engine.runs, run)) for run in (first, second)))
        rows = [asdict(row) for row in found.rows()]
        return {
            "figures": found.as_dict(),
            "rows": rows,
            "words": found.text(f"run {first}", f"run {second}"),
        }

    async def report(self, request: web.Request) -> web.Response:
        """The report as it is on disk, in a sandbox: its scripts can ask the cell nothing."""
        self._visitors.require_look(request)
        text = await asyncio.to_thread(self._report, self._number(request))
        headers = {"Content-Security-Policy": REPORT_POLICY, "X-Frame-Options": "DENY"}
        return web.Response(body=text, content_type="text/html", charset="utf-8", headers=headers)

    def _report(self, number: int) -> bytes:
        folder = load_run(self._engine.runs, number).path
        path = folder / "report.html"
        try:
            if path.stat().st_size > LONGEST_REPORT:
                raise error("FILE_UNREADABLE", f"the report of run {number} is too long")
            drawn = path.read_bytes()
        except FileNotFoundError:
            raise error("NOT_FOUND", f"run {number} has no report") from None
        if hides_altered(folder, drawn.decode("utf-8", errors="replace")):
            text = (
                f"the result of run {number} was altered or restored since its report was drawn; "
                f"'cellward report {number}' draws it anew"
            )
            raise error("FILE_UNREADABLE", text)
        return drawn

    async def seen(self, request: web.Request) -> web.Response:
        """The newest picture of a capture with the corners found in it; null where there is none."""
        self._visitors.require_look(request)
        return json_answer(await asyncio.to_thread(_newest_seen, self._engine.runs, self._number(request)))

    async def picture(self, request: web.Request) -> web.Response:
        self._visitors.require_look(request)
        content = await asyncio.to_thread(
            _picture, self._engine.runs, self._number(request), request.match_info["name"]
        )
        return web.Response(body=content, content_type="image/png")

    @staticmethod
    def _number(request: web.Request) -> int:
        return int(request.match_info["run"])


def _compared_as(run: ListedRun) -> str | None:
    """The kind of a run's result where results of that kind are compared; None for any other run."""
    job = JOBS.get(run.job)
    if run.outcome != "complete" or job is None:
        return None
    kind = kind_named(job.kind)
    return kind.name if kind.compare else None


def _result_of(run: RunFolder) -> dict[str, Any]:
    path = run.path / "result.json"
    if not path.exists():
        raise error("NOT_FOUND", f"run {run.run_id} has no result")
    if path.stat().st_size > LONGEST_RESULT:
        raise error(
            "FILE_UNREADABLE",
            f"the result of run {run.run_id} is too long for the page: use 'cellward compare'",
        )
    return run.read_result() or {}


def _newest(journal: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The newest lines, after the header from which they count the time."""
    left_out, shown = journal[:-JOURNAL_LINES], journal[-JOURNAL_LINES:]
    return [line for line in left_out if line["kind"] == "header"][-1:] + shown


def _row(run: RunFolder, end: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "run_id": run.run_id,
        "job": run.job,
        "started": run.info.get("started"),
        **{key: end.get(key) for key in ("ended", "outcome", "verdict")},
    }


def _read(run: RunFolder, name: str) -> dict[str, Any] | None:
    """A file of a run; one that cannot be read hides no other run."""
    try:
        return run.read_end() if name == "end.json" else run.read_result()
    except CellError:
        return {"outcome": "unreadable"}


def _newest_seen(runs: Path, number: int) -> dict[str, Any] | None:
    folder = load_run(runs, number).path
    path = folder / "poses.jsonl"
    if not path.is_file():
        return None
    with path.open("rb") as file:
        size = file.seek(0, 2)
        file.seek(max(0, size - TAIL_BYTES))
        lines = file.read().splitlines(keepends=True)
        file.seek(0)
        camera = json.loads(file.readline()).get("camera") or {}
    for line in reversed(lines):
        if line.startswith(b'{"kind": "pose"') and line.endswith(b"\n"):
            pose = json.loads(line)
            name = str(pose.get("image") or "")
            if not name or not (folder / name).is_file():
                return None
            corners = [corner for corner in pose["frames"][0].get("corners") or [] if corner is not None]
            size_px = [camera.get("width"), camera.get("height")]
            return {"picture": Path(name).name, "pose": pose["index"], "corners": corners, "size": size_px}
    return None


def _picture(runs: Path, number: int, name: str) -> bytes:
    """A picture of a run by the name of its file alone: what has a folder in it is no such name."""
    folder = load_run(runs, number).path / "images"
    path = folder / name
    if Path(name).name != name or path.suffix != ".png" or not path.is_file() or path.is_symlink():
        raise error("NOT_FOUND", f"picture of run {number}")
    return path.read_bytes()
