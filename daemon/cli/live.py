"""``cellward live``: the numbers of a running job as they come, on the terminal or drawn into a page."""

import time
from pathlib import Path
from typing import Annotated, Any

import typer

from cell.errors import error
from daemon.cli.jobs import connect
from daemon.cli.options import ConfigOption, JsonOption, know_configured_jobs
from daemon.cli.output import out, say
from daemon.control_client import ControlClient
from procedures.documents import kind_named
from procedures.kind import Kind, load

LOOK_S = 0.2
LINE_EACH_S = 1.0
DRAW_EACH_S = 4.0  # a page is megabytes, most of it the library that draws
KEPT_S = 60.0  # that a page shows


def live(
    plot: Annotated[
        Path | None,
        typer.Option(
            "--plot",
            help="Draw the last minute into this HTML file, again and again; open it in a browser.",
            show_default=False,
        ),
    ] = None,
    seconds: Annotated[
        float, typer.Option("--for", min=0.0, help="Stop after so many seconds; 0: with the job or Ctrl-C.")
    ] = 0.0,
    config: ConfigOption = None,
    as_json: JsonOption = False,
) -> None:
    """The numbers of a running job, live: picking from a belt shows counts, items, picks and misses."""
    with connect(config) as daemon:
        know_configured_jobs(config)
        following = LiveRows(daemon)
        following.look()
        if following.job is None:
            raise error("NOT_NOW", "no job runs; 'cellward start' starts one to look at")
        try:
            _follow(following, plot, seconds, as_json)
        except KeyboardInterrupt:
            say("The job goes on; 'cellward abort' stops it.")
    if plot is not None and not following.drawn:
        say(f"{following.job} leaves no rows to be drawn, so {plot} was not written.")


class LiveRows:
    """What has come from the daemon: ``rows`` by trace, of the last :data:`KEPT_S` seconds."""

    def __init__(self, daemon: ControlClient) -> None:
        self._daemon, self._next = daemon, dict[str, int]()
        self.run_id: int | None = None
        self.job: str | None = None
        self.numbers: dict[str, float] = {}
        self.columns: dict[str, list[str]] = {}
        self.rows: dict[str, list[list[float]]] = {}

    @property
    def drawn(self) -> str:
        """What draws the job's rows; empty when it leaves none, or nothing draws them."""
        kind = self._kind()
        return kind.live_page if self.columns and kind else ""

    @property
    def line(self) -> str:
        """The numbers of now on one line."""
        kind = self._kind()
        if kind and kind.live:
            line: str = load(kind.live)(self.numbers, self.rows)
            return line
        return ", ".join(f"{name} {value:g}" for name, value in self.numbers.items()) or "nothing yet"

    def _kind(self) -> Kind | None:
        from procedures.registry import JOBS  # with all that the jobs import

        return kind_named(JOBS[self.job].kind) if self.job in JOBS else None

    def look(self) -> dict[str, list[list[float]]] | None:
        """What is new, by trace; None when the job that was looked at has ended."""
        fresh: dict[str, list[list[float]]] = {}
        more = True
        while more:
            now = self._daemon.call("live", since=self._next)
            if self.job is not None and now["run_id"] != self.run_id:
                return None
            self.run_id, self.job, self.numbers = now["run_id"], now["job"], now["live"]
            more = False
            for name, trace in now["traces"].items():
                self._next[name] = trace["next"]
                self.columns[name] = trace["columns"]
                fresh.setdefault(name, []).extend(trace["rows"])
                more |= bool(trace["rows"])
        for name, rows in fresh.items():
            kept = self.rows.setdefault(name, [])
            kept.extend(rows)
            begin = kept[-1][0] - KEPT_S if kept else 0.0
            self.rows[name] = [row for row in kept if row[0] >= begin]
        return fresh


def _follow(following: LiveRows, plot: Path | None, seconds: float, as_json: bool) -> None:
    began = time.monotonic()
    lines, draws = Every(LINE_EACH_S), Every(DRAW_EACH_S)
    fresh: Any = following.rows
    while fresh is not None:
        over = bool(seconds) and time.monotonic() - began >= seconds
        if as_json:
            _rows_out(following, fresh)
        elif over or lines.due():
            out(following.line)
        if plot is not None and following.drawn and (over or draws.due()):
            _draw(following, plot, again=not over)
        if over:
            return
        time.sleep(LOOK_S)
        fresh = following.look()
    if plot is not None and following.drawn:
        _draw(following, plot, again=False)
    say(f"Run {following.run_id} ({following.job}) has ended; 'cellward show {following.run_id}' tells how.")


class Every:
    """Whether ``period_s`` have passed since it was last due; at once the first time."""

    def __init__(self, period_s: float) -> None:
        self._period_s, self._last = period_s, float("-inf")

    def due(self) -> bool:
        now = time.monotonic()
        if now - self._last < self._period_s:
            return False
        self._last = now
        return True


def _rows_out(following: LiveRows, fresh: dict[str, list[list[float]]]) -> None:
    """One object a line: the trace, and a row by its columns; then the numbers of now."""
    import json

    for name, rows in fresh.items():
        for row in rows:
            out(json.dumps({"trace": name, **dict(zip(following.columns[name], row, strict=True))}))
    out(json.dumps({"live": following.numbers}))


def _draw(following: LiveRows, plot: Path, again: bool) -> None:
    title = f"{following.job}, run {following.run_id}"
    page = load(following.drawn)(title, following.rows, DRAW_EACH_S if again else None)
    temporary = plot.with_name(f".{plot.name}.tmp")
    try:
        temporary.write_text(page, "utf-8")  # not to the disk with force: the job writes there, too
        temporary.replace(plot)
    except OSError as exc:
        raise error("ARGUMENT_INVALID", f"--plot {plot} cannot be written: {exc.strerror or exc}") from exc
