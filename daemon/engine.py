"""The job engine: one job at a time, three ways out, and exactly one terminal journal entry."""

import asyncio
import logging
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from cell.devices import Arm
from cell.errors import CellError, LatchError, error
from cell.formats.result import NO_FIGURES
from cell.kinds import as_kind
from cell.packml import PackML
from cell.procedure import Procedure, Run
from cell.store.runs import RunFolder
from daemon.adoption import adoptable
from daemon.arm_joints import arm_joints
from daemon.cell_context import CellContext
from daemon.deciding import Decisions
from daemon.dry_run import dry_run
from daemon.last_seconds import keep_last_seconds
from daemon.losses import Losses
from daemon.movable import ASKED_BY_S
from daemon.program_start import ProgramStart
from daemon.recipes import arguments_of_recipe, with_recipe
from daemon.results import keep_answer, note_arm_model, propose_results
from daemon.run_end import failure_of, keep_shown, main_figure_of, write_end
from daemon.run_making import make_run, withdraw_run
from daemon.run_timing import RunTiming
from daemon.start_needs import StartNeeds
from daemon.start_request import StartRequest
from daemon.state_folder import folder_lost
from daemon.status import live_of, status_of
from daemon.tools import ARGUMENT, told_tool
from procedures.arm_setup import arm_models

log = logging.getLogger("cellward.engine")

CLOSING = "the run is over and its end is being written; ask again then"
WAITING = {PackML.IDLE, PackML.STOPPED, PackML.ABORTED, PackML.COMPLETE}


class Engine:
    """Starts, steers and ends jobs; everything outside asks this object."""

    def __init__(self, context: CellContext, jobs: Mapping[str, type[Procedure]], runs: Path) -> None:
        self.context, self.ledger, self.runs = context, context.ledger, runs
        self.idle_state = PackML.IDLE
        self.run: Run | None = None
        self.last: dict[str, Any] | None = None
        self.figures = NO_FIGURES  # of the last result, for registers
        self.error: CellError | None = None
        self.interrupted: list[int] = []
        self.loop_lag: Callable[[], dict[str, float]] = dict
        self.disk: Callable[[], dict[str, Any]] = dict
        self.due: Callable[[], list[dict[str, Any]]] = list  # calibrations that want to be checked
        self.report_wanted: Callable[[Path], None] = lambda folder: None
        self._starting = ""  # the job whose run is being made
        self._task: asyncio.Task[None] | None = None  # the run with its beginning and end
        self._job: asyncio.Task[None] | None = None  # the procedure alone
        self._ending: PackML | None = None
        self._work_barred_by = ""  # who wants no new items begun, in this run or the next
        self._hold_by = ""  # who asked to hold the run that is still being made
        self._finish_by = ""  # who asked to finish it, which it cannot yet: the arm's program is not started
        self._closing = False  # the end is being written: nothing can be asked of the run any more
        self._listeners: list[Callable[[], None]] = []
        self.needs = StartNeeds(context, context.ledger, jobs)
        self.program_start = ProgramStart(context, self.publish)
        self.decisions = Decisions(self)

    @property
    def jobs(self) -> Mapping[str, type[Procedure]]:
        """Those that can be started, by name."""
        return self.needs.jobs

    # -- what outside asks for

    async def start(self, request: StartRequest) -> dict[str, Any]:
        """Start a job, or list its plan without moving. Refused with a code, never queued."""
        if (run := self.running) is not None:
            raise error("BUSY", f"{run.procedure.name}, run {run.id}")
        if self._starting:
            raise error("BUSY", f"{self._starting} is being started")
        self.program_start.require_idle()
        request = with_recipe(self.context.config, request)
        self._starting, self._ending, self._hold_by, self._finish_by = request.job, None, "", ""
        try:
            return await self._start(request)
        finally:
            self._starting = ""
            if self._task is None:
                self._ending = None

    async def _start(self, request: StartRequest) -> dict[str, Any]:
        needs, context = self.needs, self.context
        recipe = arguments_of_recipe(context.config, request)
        procedure = needs.procedure(request.job, request.params, recipe)
        asked = request.params.get(ARGUMENT, recipe.get(ARGUMENT))
        tool = needs.tool(procedure, asked, moves=not request.dry_run)
        devices = await needs.devices(procedure, ASKED_BY_S)
        if context.broker.latched is not None and not request.dry_run:
            raise error("MOTION_LATCHED", f"the last fault was: {context.broker.latched}")
        values = await needs.values(procedure, tool, request.recipe)
        models = await asyncio.to_thread(arm_models, values)
        conditions = await needs.conditions(request, procedure, values, devices)
        adopted = adoptable(self.runs, request.adopt, procedure.name, conditions)
        started_by = None if request.dry_run else (request.who, request.channel)
        folder = await make_run(
            self.runs,
            self.ledger,
            request.job,
            conditions,
            context.clock,
            started_by,
            tool.name if tool is not None and "arm" in procedure.uses() else None,
        )
        try:
            run = Run(
                folder.run_id, procedure, context, folder.path, folder, values, self.publish, adopted, models
            )
            if request.dry_run:
                return await dry_run(run, folder)
            self._begin(run, request)
        except BaseException:
            if not request.dry_run:
                await withdraw_run(folder, self.ledger)
            raise
        self.run, self.error = run, None
        self.program_start.asked(run, request)
        if self._finish_by:
            self.program_start.withdraw(self._finish_by)
        self._task = asyncio.create_task(self._execute(run, folder, devices), name=f"run {run.id}")
        self.publish()
        return {"run_id": run.id, "folder": folder.path.name}

    def _begin(self, run: Run, request: StartRequest) -> None:
        """The first lines of its journal, and what was asked of the run while it was made."""
        run.note("operator", event="start", who=request.who, channel=request.channel)
        note_arm_model(run)
        if self._ending is not None:
            run.note("operator", event="stopped before it began")
        if self._hold_by:
            run.note("operator", event="pause", who=self._hold_by)
            run.pause()
        if self._work_barred_by:
            run.want_work(False, self._work_barred_by)

    async def confirm(self, prompt_id: int, who: str) -> None:
        self._active().confirm(prompt_id, who)

    async def skip(self, prompt_id: int, who: str) -> None:
        self._active().skip(prompt_id, who)

    async def finish(self, who: str) -> None:
        """End at the next checkpoint and keep the data; refused while the run is still being made."""
        if self._starting and self._task is None:
            self._finish_by = who
        if self._only_a_program(who):
            return
        run = self._active()
        run.note("operator", event="finish", who=who)
        run.finish()

    async def abort(self, who: str) -> None:
        self._end_with(PackML.STOPPING, "abort", who)

    async def halt(self, who: str) -> None:
        self._end_with(PackML.ABORTING, "halt", who)

    async def pause(self, who: str) -> None:
        self.hold(who)

    def hold(self, who: str) -> None:
        """Hold at the next checkpoint, with the arm at rest; a run that is being made, at its first."""
        if self._starting and self._task is None:
            self._hold_by = who
            return
        if self._only_a_program(who):
            return
        run = self._active()
        run.note("operator", event="pause", who=who)
        run.pause()

    def want_work(self, wanted: bool, who: str) -> None:
        """``False``: a job that goes item by item finishes the one in hand and waits.

        A level, like the bit of the PLC that says it: it holds for runs that start meanwhile, too, and they
        write it to their journal.
        """
        self._work_barred_by = "" if wanted else who
        if (run := self.running) is not None and not self._closing:
            run.want_work(wanted, who)

    async def resume(self, who: str) -> None:
        run = self._active()
        run.note("operator", event="resume", who=who)
        run.resume()

    async def reset(self, who: str) -> None:
        """Leave Aborted or Stopped; refused while the arm itself still shows a fault."""
        if self._task is not None:
            raise error("NOT_NOW", CLOSING if self._closing else "a job is running; stop it first")
        if (fault := self.arm_fault()) is not None:
            raise error("NOT_NOW", f"the arm still shows: {fault}")
        self.context.broker.reset()
        self.error = None
        self.idle_state = PackML.IDLE
        log.info("reset by %s", who)
        self.publish()

    def arm_fault(self) -> Exception | None:
        """The coded error that the arm shows now, job or not."""
        arm = self._arm()
        return None if arm is None else arm.fault()

    def subscribe(self, listener: Callable[[], None]) -> Callable[[], None]:
        """Call ``listener`` after every change; the returned function ends that."""
        self._listeners.append(listener)
        return lambda: self._listeners.remove(listener)

    @property
    def active(self) -> bool:
        return self._task is not None

    @property
    def packml(self) -> PackML:
        if self._task is None or self.run is None:
            return self.idle_state
        return self._ending or self.run.packml

    @property
    def running(self) -> Run | None:
        """The run of the job that is active."""
        return self.run if self._task is not None else None

    def status(self) -> dict[str, Any]:
        """What a person or a PLC may want to see at a glance."""
        return status_of(self)

    def live(self, since: Mapping[str, int]) -> dict[str, Any]:
        """Numbers and rows of traces of the running job, to be drawn; see :func:`daemon.status.live_of`."""
        return live_of(self, since)

    def joints(self) -> dict[str, Any]:
        """Where the arm stands; see :func:`daemon.arm_joints.arm_joints`."""
        return arm_joints(self.context)

    async def shutdown(self) -> None:
        """End a running job as ``halt`` does and wait for its standstill."""
        if self._task is not None:
            if not self._closing:
                self._end_with(PackML.ABORTING, "shutdown", "daemon")
            await asyncio.wait([self._task])
        await self.program_start.close()

    # -- how a run is made and ends

    def _arm(self) -> Arm | None:
        """The arm in whatever state it is; None in a cell without one."""
        name = self.context.config.robot.roles().get("arm")
        return as_kind(self.context.supervisor.devices[name].device, Arm) if name else None

    async def _execute(self, run: Run, folder: RunFolder, devices: list[str]) -> None:
        """Run the procedure to whichever end, then write that end down once."""
        failure: CellError | None = None
        timing = RunTiming(self.context.lag_into, self._arm())
        job = self._job = asyncio.create_task(self._work(run), name=run.procedure.name)
        arm = self._arm()
        watched = arm if arm is not None and arm.name in devices else None
        losses = Losses(self.context.supervisor, self.context.broker, devices, watched)
        loss = asyncio.create_task(losses.first(run), name="watch devices")
        gone = asyncio.create_task(folder_lost(folder, self.context.clock), name="watch the run's folder")
        if self._ending is not None:  # a stop came before the job could begin
            job.cancel()
        try:
            limit = getattr(run.procedure.config, "max_duration_s", None)
            await asyncio.wait([job, loss, gone], timeout=limit, return_when=asyncio.FIRST_COMPLETED)
            if not job.done():
                ended = next((watch for watch in (loss, gone) if watch.done()), None)
                failure = ended.result() if ended else error("CALL_TIMEOUT", f"no end after {limit:g} s")
                self._ending = PackML.ABORTING
                job.cancel()
                run.note("error", **failure.as_dict())
                self.publish()
            await asyncio.wait([job])
            failure = failure or self._told_by_loss(failure_of(job), devices)
            # While the data are on disk nothing about them may fail the run silently.
            if failure is None and not job.cancelled():
                self._set_ending(PackML.COMPLETING)
                await propose_results(run, folder, self.ledger)
        except CellError as exc:
            failure = failure or exc
        except Exception as exc:
            log.exception("run %d", run.id)
            failure = failure or error("INTERNAL", f"{type(exc).__name__}: {exc}")
        finally:
            loss.cancel()
            gone.cancel()
            job.cancel()  # it is over, unless this task itself failed
            await asyncio.wait([job, loss, gone])
            with suppress(CellError):  # a folder that cannot be written: the end says so
                run.note("device", device="cell PC", event="timing", **timing.end())
                if failure is not None:
                    used = [self.context.supervisor.devices[name].device for name in devices]
                    await keep_last_seconds(folder.path, used, self.context.clock.now())
            await self._close(run, folder, job, failure)

    async def _work(self, run: Run) -> None:
        """The procedure; what is to follow it by itself watches the arm from its end on, without a gap."""
        await run.procedure.run(run)
        self.program_start.procedure_over(run)

    async def _close(
        self, run: Run, folder: RunFolder, job: asyncio.Task[None], failure: CellError | None
    ) -> None:
        """The run's one terminal line; whatever happens to it, the next run can start."""
        self._closing = True
        if failure is not None:
            final, outcome = PackML.ABORTED, "aborted"
        elif job.cancelled():
            stopped = self._ending is PackML.STOPPING
            final, outcome = (PackML.STOPPED, "stopped") if stopped else (PackML.ABORTED, "halted")
        else:
            final, outcome = PackML.COMPLETE, "complete"
        if isinstance(failure, LatchError):
            self.context.broker.latch(failure)
        if failure is not None:  # told before the answer is kept, which may take half a minute
            self.error, self._ending = failure, PackML.ABORTING
            self.publish()
        kept = outcome != "complete" and await keep_answer(run, folder)
        verdict = run.result.verdict if run.result else None
        end = {
            "outcome": outcome,
            "packml": final.name,
            "verdict": verdict,
            "figure": main_figure_of(run),
            "error": failure.as_dict() if failure else None,
        }
        unwritten = await write_end(run, folder, self.ledger, end)
        failure = failure or unwritten
        with suppress(Exception):  # nothing keeps the next run from starting; who asks the ledger is told
            await self.decisions.look()
        await asyncio.to_thread(keep_shown, run)
        self.last = {
            "run_id": run.id,
            "job": run.procedure.name,
            "tool": told_tool(self.context.config, run.values.tool),
            "result": run.shown,
            "steps_taken_again": len(run.steps_taken.taken_again),
            **end,
        }
        self.figures = run.figures
        self.error, self.idle_state = failure, final
        self._task = self._job = self._ending = None
        self._closing = False
        level = logging.INFO if failure is None else logging.ERROR
        told = failure or verdict
        log.log(level, "run %d %s%s", run.id, outcome, f": {told}" if told else "")
        self.publish()
        if run.result is None or kept:
            self.report_wanted(folder.path)
        self.program_start.ended(run, folder, end, failure)

    def _told_by_loss(self, failure: CellError | None, devices: list[str]) -> CellError | None:
        """A job may find a device gone a moment before the watch does; the loss is the cause to name."""
        if failure is None or failure.name != "DEVICE_NOT_READY":
            return failure
        loss = self.context.supervisor.loss(devices)
        return loss if isinstance(loss, CellError) else failure

    def _end_with(self, ending: PackML, verb: str, who: str) -> None:
        """Stop first, and write it down after: a full disk must not keep anybody from stopping."""
        if self._starting and self._task is None:
            self._ending = self._ending or ending  # the run that is being made ends before it begins
            return
        if self._only_a_program(who):
            return
        run = self._active()
        if self._ending is None:
            self._ending = ending
            if self._job is not None:
                self._job.cancel()
            run.note("operator", event=verb, who=who)
            self.publish()

    def _only_a_program(self, who: str) -> bool:
        """The arm's own program is not started for this run; True where nothing but that can be stopped."""
        return self.program_start.withdraw(who) and (self._task is None or self._closing)

    def _set_ending(self, state: PackML) -> None:
        self._ending = state
        self.publish()

    def _active(self) -> Run:
        if self._task is None or self.run is None or self._closing:
            raise error("NOT_NOW", CLOSING if self._closing else "no job is running")
        return self.run

    def publish(self) -> None:
        """Tell who subscribed that something has changed."""
        for listener in tuple(self._listeners):
            listener()
