"""From the result of a run to a proposed calibration, and to its report."""

import asyncio
import logging
from pathlib import Path
from typing import Any

from cell.procedure import Run
from cell.store.ledger import Ledger
from cell.store.runs import RunFolder

log = logging.getLogger("cellward.results")

CALIBRATION_OF = {"eye-in-hand": "T_flange_camera", "eye-to-hand": "T_base_camera"}


async def propose_results(run: Run, folder: RunFolder, ledger: Ledger) -> None:
    """Write ``result.json`` and the report, propose the calibration, and accept it if a policy says so."""
    if run.result is None:
        return
    await asyncio.to_thread(folder.write_result, run.result)
    await _write_report(run)
    await asyncio.to_thread(_propose, run, ledger)


def draw_report(folder: Path) -> None:
    """In the worker: drawing, and importing what draws, would hold up the loop."""
    from procedures.report import write_report

    write_report(folder)


async def _write_report(run: Run) -> None:
    """A report that cannot be drawn is said, and never costs the result."""
    try:
        await run.worker.call(draw_report, run.folder)
    except Exception as exc:
        log.exception("report of run %d", run.id)
        run.note("error", event="no report", why=f"{type(exc).__name__}: {exc}")


def _propose(run: Run, ledger: Ledger) -> None:
    assert run.result is not None
    answer: dict[str, Any] | None = run.result.get("result")
    setup = getattr(run.procedure.config, "setup", None)
    if answer is None or setup is None or run.result["verdict"] == "fail":
        return
    name = CALIBRATION_OF[setup]
    nominal = run.values["configured"].get(name)
    result_id = ledger.propose(name, answer[name], run.result, run.id, nominal)
    run.note("decision", event="proposed", name=name, result_id=result_id)
    policy = run.procedure.config.accept
    if policy.auto and run.result["verdict"] == "pass":
        ledger.accept(result_id, "policy")
        run.note("decision", event="accepted", name=name, result_id=result_id, by="policy")
