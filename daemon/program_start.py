"""The arm's own program is started again after a check that it asked for: the one motion without a lease.

Everything that speaks against it keeps it from starting, and is said in words (docs/decisions/0053). What
was asked is kept in memory alone, so a daemon that was restarted starts nothing.
"""

import asyncio
import ipaddress
import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from cell.devices import Arm, ArmState, StartsPrograms
from cell.errors import CellError, error
from cell.kinds import as_kind
from cell.motion import MAX_STATE_AGE_S
from cell.poses import Array
from cell.procedure import Run
from cell.samples import Sample
from cell.standstill import measured_standstill
from cell.store.runs import RunFolder
from cell.to_its_end import run_to_its_end
from cell.where_left import STAYED_RAD
from daemon.cell_context import CellContext
from daemon.config.program_after import JOB
from daemon.start_request import StartRequest

log = logging.getLogger("cellward.program_start")

ASKED_WITHIN_S = 3.0  # the program that asks ended so shortly before its run begins, or it did not ask
WITHIN_S = 20.0  # of the run's end: later nobody expects the arm to move
ENDED_WITHIN_S = 0.5  # of its run a program of ours is still seen
REST_S = 2.0
SEEN_S = 5.0  # a controller shows so soon that the program runs
STOP_S = 2.0
FRESH_WITHIN_S = 0.5


@dataclass(frozen=True)
class _Left:
    """How the run left the arm."""

    q: Array  # (6,) rad
    t: float  # of that state
    epoch: int  # of the arm's states

    def require_still(self, arm: Arm) -> None:
        """Refused unless the arm was seen all the time since, and stands where it stood."""
        state = arm.state.latest(MAX_STATE_AGE_S).value
        if arm.state.epoch != self.epoch:
            raise error("DEVICE_LOST", f"{arm.name} was connected anew since the run's end")
        if (gap := arm.state.last_gap) is not None and gap[1] > self.t:
            raise error(
                "STALE_DATA", f"{arm.name} gave no state for {gap[1] - gap[0]:.3f} s since the run's end"
            )
        if (turned := float(np.max(np.abs(state.q - self.q)))) > STAYED_RAD:
            raise error("ARM_MOVED", f"{arm.name}: a joint turned by {turned:.4f} rad since the run's end")


class ProgramStart:
    """Looks at each run that begins and ends; at most one program is being started.

    ``told`` is None, or what status and page show: ``run_id``, ``program``, ``state`` (``asked``,
    ``starting``, ``started``, ``not started``) and ``text``.
    """

    def __init__(self, context: CellContext, publish: Callable[[], None]) -> None:
        self._context, self._publish = context, publish
        self._section = context.config.robot.program_after
        self.told: dict[str, Any] | None = None
        self._refused: str | None = None  # why the run that was asked for will start nothing
        self._idle_since = float("-inf")  # our own programs ran until then
        self._task: asyncio.Task[None] | None = None
        self._sent = False  # the controller may have been told to start
        self._withdrawn_by = ""

    # -- what the engine says

    def require_idle(self) -> None:
        """``BUSY`` while the program is being started: no job may begin beside it."""
        if self._task is not None:
            raise error("BUSY", f"the arm's own program {self._program} is being started")

    def asked(self, run: Run, request: StartRequest) -> None:
        """``run`` begins as ``request`` has it: whether a program of the robot asks."""
        self.told = None
        section = self._section
        if section is None or request.channel != "modbus" or not _same(request.client, section.asked_from):
            return
        self._refused = None
        if request.job != JOB:
            self._refused = f"it was a {request.job}, and only after a {JOB} a program is started"
        elif not self._program_ended():
            self._refused = "no program ran on the arm when the check was asked for"
        if self._refused:
            self._tell(run.id, "not started", f"{self._not_started(run.id)}: {self._refused}")
            return
        text = f"when run {run.id} has passed, the arm's own program {section.program} is started"
        self._tell(run.id, "asked", f"{text}: the arm moves")

    def ended(self, run: Run, folder: RunFolder, end: Mapping[str, Any], failure: CellError | None) -> None:
        """The run's end is written, and the next may begin."""
        self._idle_since = self._context.clock.now() + ENDED_WITHIN_S
        if self.told is None or self.told["run_id"] != run.id:
            return
        why = self._refused or _objection(run, end, failure)
        self._sent, self._withdrawn_by = False, ""
        work = self._refuse(run.id, folder, why) if why else self._start(run.id, folder)
        self._task = asyncio.create_task(work, name=f"program after run {run.id}")
        self._task.add_done_callback(self._over)

    def withdraw(self, who: str) -> bool:
        """Somebody stops or holds: what is being started is not, or is stopped. Whether anything was."""
        if self._task is None or self._is_told():
            return False
        self._withdrawn_by = self._withdrawn_by or who
        self._task.cancel()
        return True

    async def close(self) -> None:
        """The daemon ends: nothing is started any more."""
        if self._task is not None:
            self.withdraw("the end of the daemon")
            await asyncio.wait([self._task])

    # -- inside

    def _is_told(self) -> bool:
        """Whether it is decided already what becomes of the program."""
        return self.told is not None and self.told["state"] in ("started", "not started")

    @property
    def _program(self) -> str:
        return self._section.program if self._section is not None else ""

    def _program_ended(self) -> bool:
        """A program that is not ours ran on the arm a moment ago."""
        now = self._context.clock.now()
        states = as_kind(self._named(), Arm).state.between(max(now - ASKED_WITHIN_S, self._idle_since), now)
        return any(state.value.program_running for state in states)

    def _arm(self) -> Arm:
        """The arm; ``DEVICE_NOT_READY`` while it is not."""
        return as_kind(self._context.device("arm"), Arm)

    async def _refuse(self, run_id: int, folder: RunFolder, why: str) -> None:
        await self._told(run_id, folder, "not started", f"{self._not_started(run_id)}: {why}")

    async def _start(self, run_id: int, folder: RunFolder) -> None:
        """Start it. Whatever comes in between is told, and a start half made is undone."""
        program = self._program
        try:
            arm = self._arm()
            await arm.wait_fresh(FRESH_WITHIN_S)
            now = arm.state.latest(MAX_STATE_AGE_S)
            left = _Left(now.value.q, now.t, arm.state.epoch)
            text = f"run {run_id} has passed: the arm's own program {program} is being started"
            await self._told(run_id, folder, "starting", text)
            await self._lent(arm, left)
        except asyncio.CancelledError:
            await run_to_its_end(self._undo(run_id, folder, f"stopped by {self._withdrawn_by}"))
        except CellError as exc:
            await run_to_its_end(self._undo(run_id, folder, str(exc)))
        except Exception as exc:
            log.exception("the program after run %d", run_id)
            await run_to_its_end(self._undo(run_id, folder, f"{type(exc).__name__}: {exc}"))
        else:
            text = f"after run {run_id} the arm's own program {program} was started; it moves the arm"
            await self._told(run_id, folder, "started", text)

    async def _lent(self, arm: Arm, left: _Left) -> None:
        """Load and play while no job can get the arm, and no package of it shows a fault."""
        broker = self._context.broker
        broker.acquire(arm)
        fault = asyncio.create_task(broker.first_fault(arm), name="watch the arm")
        work = asyncio.create_task(self._load_and_play(arm, left), name="load and play")
        try:
            await asyncio.wait([fault, work], timeout=WITHIN_S, return_when=asyncio.FIRST_COMPLETED)
            if fault.done():
                raise fault.result()
            if not work.done():
                raise error("CALL_TIMEOUT", f"{self._program} was not started within {WITHIN_S:g} s")
            work.result()
        finally:
            fault.cancel()
            work.cancel()
            await asyncio.wait([fault, work])
            broker.release(arm)

    async def _load_and_play(self, arm: Arm, left: _Left) -> None:
        starter = as_kind(arm, StartsPrograms)
        arm.check_movable()
        await starter.load_program(self._program)
        if not await measured_standstill(arm, REST_S):
            raise error("ARM_MOVED", f"{arm.name} was not seen at rest")
        self._arm()  # still READY
        left.require_still(arm)
        runs = asyncio.Event()

        def look(sample: Sample[ArmState]) -> None:
            if sample.value.program_running:
                runs.set()

        unsubscribe = arm.state.subscribe(look)
        try:
            self._sent = True
            await starter.play_program()
            async with asyncio.timeout(SEEN_S):
                await runs.wait()
        except TimeoutError:
            text = f"{arm.name} shows no program that runs {SEEN_S:g} s after it was told to"
            raise error("ARM_PROGRAM_NOT_STARTED", text) from None
        finally:
            unsubscribe()

    async def _undo(self, run_id: int, folder: RunFolder, why: str) -> None:
        """A program that may have been started is stopped: nobody expects it to start later."""
        if self._sent:
            try:
                async with asyncio.timeout(STOP_S):
                    await as_kind(self._named(), Arm).stop_program()
                why += "; the arm's program was stopped"
            except Exception as exc:
                why += f"; the stop of the arm's program failed ({exc}): look at the arm, it may run"
        await self._refuse(run_id, folder, why)

    def _named(self) -> Any:
        """The arm in whatever state it is."""
        name = self._context.config.robot.roles()["arm"]
        return self._context.supervisor.devices[name].device

    async def _told(self, run_id: int, folder: RunFolder, state: str, text: str) -> None:
        """In status, page, log and journal. Nothing is started that the journal does not take first."""
        log.log(logging.WARNING if state == "not started" else logging.INFO, "%s", text)
        self._tell(run_id, state, text)
        try:
            await asyncio.to_thread(_note, folder, state, text)
        except CellError as exc:
            if state == "starting":
                raise
            log.error("run %d: not in the journal (%s): %s", run_id, exc, text)

    def _tell(self, run_id: int, state: str, text: str) -> None:
        self.told = {"run_id": run_id, "program": self._program, "state": state, "text": text}
        self._publish()

    def _not_started(self, run_id: int) -> str:
        return f"after run {run_id} the arm's own program {self._program} is not started"

    def _over(self, task: asyncio.Task[None]) -> None:
        self._task = None
        if task.cancelled() and self.told is not None and not self._is_told():  # before its first step
            run_id = self.told["run_id"]
            self._tell(run_id, "not started", f"{self._not_started(run_id)}: stopped by {self._withdrawn_by}")
        self._publish()


def _objection(run: Run, end: Mapping[str, Any], failure: CellError | None) -> str | None:
    """Why a run is none after which the arm may move by itself; None when it is one."""
    if end["outcome"] != "complete":
        return f"the run ended {end['outcome']}"
    if failure is not None:
        return str(failure)
    if end["verdict"] != "pass":
        return f"its verdict is {end['verdict'] or 'none'}, not pass"
    if run.steered:
        return "somebody held it, finished it early, or answered a question of it"
    if taken := len(run.steps_taken.taken_again):
        return f"a device was silent during it ({taken} step{'s' * (taken > 1)} taken again)"
    return None


def _note(folder: RunFolder, state: str, text: str) -> None:
    try:
        folder.note("motion", event=f"program of the arm {state}", why=text)
    finally:
        folder.close()


def _same(client: str, address: str) -> bool:
    try:
        found = ipaddress.ip_address(client)
    except ValueError:
        return False
    mapped = getattr(found, "ipv4_mapped", None) or found
    return bool(mapped == ipaddress.ip_address(address))
