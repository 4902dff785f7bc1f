"""What a person or a PLC sees of the engine at a glance, and what a page draws while a job runs."""

from collections.abc import Callable, Mapping
from typing import Any, Protocol

from cell.errors import CellError
from cell.packml import PackML
from cell.procedure import Run
from cell.store.ledger import Ledger
from daemon.cell_context import CellContext
from daemon.deciding import Decisions
from daemon.program_start import ProgramStart
from daemon.tools import told_tool

LIVE_ROWS = 250  # of a trace in one answer: more would hold up a loop that decides every 20 ms


class Shown(Protocol):
    """What is shown of the engine."""

    context: CellContext
    ledger: Ledger
    last: dict[str, Any] | None
    error: CellError | None
    interrupted: list[int]
    loop_lag: Callable[[], dict[str, float]]
    disk: Callable[[], dict[str, Any]]
    due: Callable[[], list[dict[str, Any]]]
    program_start: ProgramStart
    decisions: Decisions

    @property
    def packml(self) -> PackML: ...
    @property
    def running(self) -> Run | None: ...


def status_of(engine: Shown) -> dict[str, Any]:
    """Everything a person or a PLC may want to see at a glance."""
    run, context = engine.running, engine.context
    return {
        "cell": context.config.cell.name,
        "twin": context.config.cell.twin,
        "packml": engine.packml.name,
        "packml_number": int(engine.packml),
        "job": run.procedure.name if run else None,
        "job_number": run.procedure.number if run else 0,
        "tool": told_tool(context.config, run.values.tool) if run else None,
        "run_id": run.id if run else None,
        "state": run.state.value if run and run.state else None,
        "step": run.step if run else 0,
        "steps": run.steps if run else 0,
        "steps_taken_again": len(run.steps_taken.taken_again) if run else 0,
        "silences_in_a_row": run.steps_taken.in_a_row if run else 0,
        "live": dict(run.live) if run else {},
        "prompt": _prompt_of(run) if run else None,
        "error": engine.error.as_dict() if engine.error else None,
        "latched": context.broker.latched is not None,
        "last_run": engine.last,
        "interrupted": engine.interrupted,
        "ledger_damage": engine.ledger.damage(),
        "disk": engine.disk(),
        "due": engine.due(),
        "waiting": engine.decisions.waiting,
        "program_start": engine.program_start.told,
        "devices": context.supervisor.status(),
        "loop_lag": engine.loop_lag(),
    }


def _prompt_of(run: Run) -> dict[str, Any] | None:
    if run.prompt is None:
        return None
    return {"id": run.prompt[0], "text": run.prompt[1], "skippable": run.skippable}


def live_of(engine: Shown, since: Mapping[str, int]) -> dict[str, Any]:
    """What the running job leaves to be drawn: numbers of now, and the rows of each trace from row
    ``since[name]`` on, a bounded number at a time. ``next`` is what to ask for after them."""
    run = engine.running
    traces = {}
    for name, trace in run.traces.items() if run else ():
        end, rows = trace.since(since.get(name, 0), LIVE_ROWS)
        traces[name] = {"columns": trace.columns, "next": end, "rows": rows}
    return {
        "run_id": run.id if run else None,
        "job": run.procedure.name if run else None,
        "state": run.state.value if run and run.state else None,
        "live": dict(run.live) if run else {},
        "traces": traces,
    }
