"""From the result of a run to a proposed calibration, and to its report."""

import asyncio
import logging
from collections.abc import Awaitable, Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from cell.calibrations import rests_on_kinematics
from cell.errors import CellError, error
from cell.formats.result import Envelope, StepTakenAgain, Warning_
from cell.procedure import Procedure, Proposal, Run
from cell.store.ledger import Ledger
from cell.store.runs import RunFolder
from daemon.stored_result import kept_of, texts_of
from procedures.in_worker import in_worker
from procedures.kinematics_in_use import in_words, misfits, with_model
from procedures.replay import solve_again

ANSWER_S = 30.0  # longest time that the end of a run waits for its answer ...
FALL_BACK_S = 10.0  # ... and for the one before to be written where that fails
NOT_RENEWED = "answer.not-renewed"
Elsewhere = Callable[..., Awaitable[Any]]  # a call in the worker, or in a thread
log = logging.getLogger("cellward.results")


async def propose_results(run: Run, folder: RunFolder, ledger: Ledger) -> None:
    """Write ``result.json`` and the report, propose the calibration, and accept it if a policy says so.

    ``RESULT_INVALID`` for a result that does not fit its kind: it is kept on disk, and nothing is proposed.
    """
    if run.result is None:
        return
    proposal = None if run.result.verdict == "fail" else run.procedure.proposal(run)
    renewed = run.proposed | ({proposal.name} if proposal else set())
    run.result = with_interruptions(with_model(run.result, run.values, renewed), run).signed()
    where, value = str(folder.path / "result.json"), proposal.value if proposal else None
    made = await in_worker(run.worker, texts_of, run.result, where, value)
    run.figures, run.shown = made.kept.figures, made.kept.shown
    await asyncio.to_thread(folder.write_result, made.result)
    if made.kept.misfit is not None:
        raise made.kept.misfit
    if proposal is not None:  # before the report, which names the result and the command that decides
        as_text = replace(proposal, value=made.value)
        await asyncio.to_thread(_propose, run, ledger, as_text, made.kept.summary, run.result.verdict)
    await _write_report(run)


async def keep_answer(run: Run, folder: RunFolder) -> bool:
    """``result.json`` of a run that had its answer and was ended before it was over, from the data that it
    left, as ``cellward solve`` makes it; nothing is proposed. Where that fails, the answer that it had
    before, which warns of that. Whether there is one; the journal says why not.
    """
    if not run.answered:
        return False
    before, run.result = run.result, None  # of what the data set was before
    try:
        async with asyncio.timeout(ANSWER_S):
            asked = run.procedure.name, folder.path, folder.info, dict[str, Any]()
            found = await in_worker(run.worker, solve_again, *asked)
            await _keep(run, folder, found, partial(in_worker, run.worker))
    except Exception as exc:  # it must not cost the end of the run
        why = _not_kept(run, "answer not solved again", exc, ANSWER_S)
    else:
        return True
    if before is None:
        return False
    again = f"the data are kept: cellward solve {run.procedure.kind} {folder.path}"
    text = f"what was measured after the answer is not in it, as it was not solved again ({why}); {again}"
    try:
        async with asyncio.timeout(FALL_BACK_S):  # in a thread: the worker may still be solving
            warned = before.judged((), [Warning_(code=NOT_RENEWED, text=text)])
            await _keep(run, folder, warned, asyncio.to_thread)
    except Exception as exc:
        _not_kept(run, "answer not kept", exc, FALL_BACK_S)
        return False
    return True


async def _keep(run: Run, folder: RunFolder, found: Envelope, elsewhere: Elsewhere) -> None:
    """``found`` in ``result.json`` and as the result of the run; its text is made ``elsewhere``."""
    result = with_interruptions(with_model(found, run.values, run.proposed), run).signed()
    made = await elsewhere(texts_of, result, str(folder.path / "result.json"), None)
    await asyncio.to_thread(folder.write_result, made.result)
    run.result, run.figures, run.shown = result, made.kept.figures, made.kept.shown


def _not_kept(run: Run, event: str, exc: Exception, limit_s: float) -> str:
    """Note why, and return it in words."""
    log.error("run %d: %s", run.id, event, exc_info=exc)
    late = f"it took longer than {limit_s:g} s"
    why = late if isinstance(exc, TimeoutError) else f"{type(exc).__name__}: {exc}"
    with suppress(CellError):
        run.note("error", event=event, why=why)
    return why


def with_interruptions(result: Envelope, run: Run) -> Envelope:
    """``result`` with the steps that short silences made the run take again, in its ``inputs``."""
    again = [StepTakenAgain.model_validate(step) for step in run.steps_taken.taken_again]
    return result.with_inputs(steps_taken_again=again) if again else result


def note_arm_model(run: Run) -> None:
    """Into the journal: the model of the arm that the run works with, and what was made with another."""
    model = run.values.arm_model
    run.note("decision", event="arm model", words=in_words(model), **model)
    for name, why in misfits(run.values).items():
        run.note("decision", event="made with another arm model", calibration=name, why=why)


def draw_report(folder: Path) -> None:
    """In the worker: drawing, and importing what draws, would hold up the loop."""
    from procedures.report.write import write_report

    write_report(folder)


async def _write_report(run: Run) -> None:
    """A report that cannot be drawn is said, and never costs the result."""
    try:
        await run.worker.call(draw_report, run.folder)
    except Exception as exc:
        log.exception("report of run %d", run.id)
        run.note("error", event="no report", why=f"{type(exc).__name__}: {exc}")


async def propose_in_mid_run(run: Run, ledger: Ledger, proposal: Proposal, result: Envelope) -> int:
    """A proposed calibration in the ledger, from a result that the run goes on with; returns its number."""
    told = with_model(result, run.values, run.proposed | {proposal.name})
    kept = await in_worker(run.worker, kept_of, told)
    return await asyncio.to_thread(enter_proposal, run, ledger, proposal, kept.summary)


def enter_proposal(run: Run, ledger: Ledger, proposal: Proposal, summary: Mapping[str, Any]) -> int:
    """A proposed calibration in the ledger, with the configured value that it would replace.

    Where its meaning rests on the arm's kinematics, the ledger notes the model that the run worked with.
    ``summary`` is of the result that it comes from.
    """
    run.check_record()
    if proposal.name not in run.values.configured:
        job = run.procedure.name
        raise error("INTERNAL", f"{job} proposes {proposal.name}, and uses no role that this belongs to")
    configured = run.values.configured[proposal.name]
    model = run.values.arm_model if rests_on_kinematics(proposal.name) else None
    run.proposed.add(proposal.name)
    result_id = ledger.propose(
        proposal.name, proposal.value, summary, run.id, configured, model, run.folder.name
    )
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


def _propose(run: Run, ledger: Ledger, proposal: Proposal, summary: Mapping[str, Any], verdict: str) -> None:
    result_id = enter_proposal(run, ledger, proposal, summary)
    run.check_record()
    if proposal.auto and verdict == "pass":
        ledger.accept(result_id, "policy")
        run.note("decision", event="accepted", name=proposal.name, result_id=result_id, by="policy")
