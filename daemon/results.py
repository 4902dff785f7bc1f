"""From the result of a run to a proposed calibration, and to its report."""

import asyncio
import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from cell.procedure import Procedure, Proposal, Run
from cell.store.ledger import Ledger
from cell.store.runs import RunFolder

log = logging.getLogger("cellward.results")


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


def enter_proposal(run: Run, ledger: Ledger, proposal: Proposal, result: Mapping[str, Any]) -> int:
    """A proposed calibration in the ledger, with the configured value that it would replace."""
    configured = run.values["configured"].get(proposal.name)
    result_id = ledger.propose(proposal.name, proposal.value, result, run.id, configured)
    run.note("decision", event="proposed", name=proposal.name, result_id=result_id)
    return result_id


def reject_left_open(ledger: Ledger, jobs: Mapping[str, type[Procedure]]) -> list[int]:
    """Turn down what runs left open that decide themselves: they were interrupted, and never confirmed it."""
    found = [i for job in jobs.values() if job.decides for i in ledger.open_results_of_job(job.name)]
    for result_id in found:
        row = ledger.reject(result_id, "daemon", "its run ended before it was confirmed")
        log.warning(
            "result %d (%s) was rejected: its run ended before it was confirmed", result_id, row["name"]
        )
    return found


def _propose(run: Run, ledger: Ledger) -> None:
    assert run.result is not None
    if run.result["verdict"] == "fail" or (proposal := run.procedure.proposal(run)) is None:
        return
    result_id = enter_proposal(run, ledger, proposal, run.result)
    if proposal.auto and run.result["verdict"] == "pass":
        ledger.accept(result_id, "policy")
        run.note("decision", event="accepted", name=proposal.name, result_id=result_id, by="policy")
