"""The arm's own program is started again after a check that it asked for: the one motion without a lease.

Everything that speaks against it keeps it from starting, and is said in words (docs/decisions/0053). What
was asked is kept in memory alone, so a daemon that was restarted starts nothing.
"""

import asyncio
import ipaddress
import logging
from collections.abc import Callable, Mapping
from typing import Any

from cell.devices import Arm, StartsPrograms
from cell.errors import CellError, error
from cell.kinds import as_kind
from cell.procedure import Run
from cell.standstill import measured_standstill
from cell.store.runs import RunFolder
from cell.to_its_end import run_to_its_end
from daemon.arm_since import ArmSince
from daemon.cell_context import CellContext
from daemon.config.program_after import JOB
from daemon.program_seen import SEEN_S, ProgramSeen, stop_until_seen
from daemon.start_request import StartRequest

log = logging.getLogger("cellward.program_start")

ASKED_WITHIN_S = 3.0  # the program that asks ended so shortly before its run begins, or it did not ask
WITHIN_S = 20.0  # of the run's end: later nobody expects the arm to move
ENDED_WITHIN_S = 0.5  # of its run a program of ours is still seen
REST_S = 2.0
FRESH_WITHIN_S = 0.5


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
        self._begun = False  # to start it
        self._objected_by = ""  # who stopped or held since the run was asked for
        self._since: ArmSince | None = None  # the job was done
        self._aftermath = ""  # of a start that was taken back

    # -- what the engine says

    def require_idle(self) -> None:
        """``BUSY`` while the program is being started: no job may begin beside it."""
        if self._task is not None:
            raise error("BUSY", f"the arm's own program {self._program} is being started")

    def asked(self, run: Run, request: StartRequest) -> None:
        """``run`` begins as ``request`` has it: whether a program of the robot asks."""
        self.told, self._refused = None, None
        self._objected_by = self._aftermath = ""
        self._sent = self._begun = False
        if self._since is not None:
            self._since.end()
            self._since = None
        section = self._section
        if section is None or request.channel != "modbus" or not _same(request.client, section.asked_from):
            return
        if request.job != JOB:
            self._refused = f"it was a {request.job}, and only after a {JOB} a program is started"
        elif not self._program_ended():
            self._refused = "no program ran on the arm when the check was asked for"
        if self._refused:
            self._tell(run.id, "not started", f"{self._not_started(run.id)}: {self._refused}")
            return
        text = f"when run {run.id} has passed, the arm's own program {section.program} is started"
        self._tell(run.id, "asked", f"{text}: the arm moves")

    def procedure_over(self, run: Run) -> None:
        """The job is done, and soon nobody watches for its devices' losses: the arm is watched here."""
        if self.told is None or self.told["run_id"] != run.id or self._is_told():
            return
        try:
            self._since = ArmSince(as_kind(self._named(), Arm))
        except CellError as exc:
            self._refused = str(exc)

    def ended(self, run: Run, folder: RunFolder, end: Mapping[str, Any], failure: CellError | None) -> None:
        """The run's end is written, and the next may begin."""
        self._idle_since = self._context.clock.now() + ENDED_WITHIN_S
        if self.told is None or self.told["run_id"] != run.id:
            return
        why = self._refused or _objection(run, end, failure)
        if why is None and self._objected_by:
            why = f"stopped by {self._objected_by}"
        since, self._since = self._since, None
        if why is None and since is not None:
            work = self._start(run.id, folder, since)
        else:
            if since is not None:
                since.end()
            work = self._refuse(run.id, folder, why or "the arm was not watched since the job was done")
        self._task = asyncio.create_task(work, name=f"program after run {run.id}")
        self._task.add_done_callback(self._over)

    def withdraw(self, who: str) -> bool:
        """Somebody stops or holds, at any time since the run was asked for: no program is started.

        One that is being started is stopped. False where none is asked for, or it is decided already.
        """
        if self.told is None or self._is_told():
            return False
        first, self._objected_by = not self._objected_by, self._objected_by or who
        if first and self._task is not None and self._begun:  # else it looks before its first step
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

    async def _start(self, run_id: int, folder: RunFolder, since: ArmSince) -> None:
        """Start it. Whatever comes in between is told, and a start half made is undone."""
        self._begun = True
        program = self._program
        try:
            arm = self._arm()
            self._require_wanted(since)
            await arm.wait_fresh(FRESH_WITHIN_S)
            text = f"run {run_id} has passed: the arm's own program {program} is being started"
            await self._told(run_id, folder, "starting", text)
            await self._lent(arm, since)
        except asyncio.CancelledError:
            why = f"stopped by {self._objected_by or 'the end of the daemon'}"
        except CellError as exc:
            why = f"stopped by {self._objected_by}" if self._objected_by else str(exc)
        except Exception as exc:
            log.exception("the program after run %d", run_id)
            why = f"{type(exc).__name__}: {exc}"
        else:
            text = f"after run {run_id} the arm's own program {program} was started; it moves the arm"
            await self._told(run_id, folder, "started", text)
            return
        finally:
            since.end()
        await self._refuse(run_id, folder, why + self._aftermath)

    def _require_wanted(self, since: ArmSince) -> None:
        """Refused once somebody has objected, the arm was touched, or nobody expects it any more."""
        if self._objected_by:
            raise error("NOT_NOW", f"stopped by {self._objected_by}")
        if self._context.clock.now() - since.began > WITHIN_S:
            raise error("CALL_TIMEOUT", f"{self._program} was not started within {WITHIN_S:g} s")
        since.require_untouched()

    async def _lent(self, arm: Arm, since: ArmSince) -> None:
        """Load and play while no job can get the arm; a start half made is undone before one can."""
        broker = self._context.broker
        broker.acquire(arm)
        try:
            try:
                await self._guarded(arm, since)
            except BaseException:
                await run_to_its_end(self._take_back(arm))
                raise
        finally:
            broker.release(arm)

    async def _guarded(self, arm: Arm, since: ArmSince) -> None:
        """Load and play while no package of the arm shows a fault."""
        left_s = since.began + WITHIN_S - self._context.clock.now()
        fault = asyncio.create_task(since.first_fault(), name="watch the arm")
        work = asyncio.create_task(self._load_and_play(arm, since), name="load and play")
        try:
            await asyncio.wait([fault, work], timeout=left_s, return_when=asyncio.FIRST_COMPLETED)
            if fault.done():
                raise fault.result()
            if not work.done():
                raise error("CALL_TIMEOUT", f"{self._program} was not started within {WITHIN_S:g} s")
            work.result()
        finally:
            fault.cancel()
            work.cancel()
            await asyncio.wait([fault, work])

    async def _load_and_play(self, arm: Arm, since: ArmSince) -> None:
        starter = as_kind(arm, StartsPrograms)
        arm.check_movable()
        await starter.load_program(self._program)
        if not await measured_standstill(arm, REST_S):
            raise error("ARM_MOVED", f"{arm.name} was not seen at rest")
        self._arm()  # still READY

        def last_look() -> None:
            self._require_wanted(since)
            self._sent = True

        async with ProgramSeen(arm) as running:
            await starter.play_program(self._program, last_look)
            if not await running.seen_within(SEEN_S):
                text = f"{arm.name} shows no program that runs {SEEN_S:g} s after it was told to"
                raise error("ARM_PROGRAM_NOT_STARTED", text)

    async def _take_back(self, arm: Arm) -> None:
        """Stop a program that may have been started; what becomes of it ends the sentence that says why."""
        if self._sent:
            self._aftermath = f"; {await stop_until_seen(arm, self._context.clock)}"

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

    def _over(self, _: asyncio.Task[None]) -> None:
        self._task = None
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
