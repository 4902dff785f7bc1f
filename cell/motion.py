"""The motion lease: the only way to move an arm, and it always ends in a measured standstill."""

import asyncio
import logging
from collections.abc import AsyncGenerator, AsyncIterator, Awaitable, Callable, Container
from dataclasses import dataclass, field
from types import AsyncGeneratorType, TracebackType
from typing import Any, Protocol, Self

import numpy as np
from scipy.spatial.transform import RigidTransform

from cell.clock import Clock
from cell.devices import Arm, ArmState, MotionPort, Speed, ToolSettings, TrajectoryPiece
from cell.errors import CellError, RefusedError, error
from cell.following import Following, along, require_full_speed
from cell.interruptions import SILENCES, Interruptions
from cell.poses import Array, to_pose6
from cell.program_end import ProgramWatch, program_ended
from cell.samples import Sample
from cell.standstill import measured_standstill
from cell.to_its_end import run_to_its_end
from cell.where_left import STAYED_RAD, WhereLeft

log = logging.getLogger("cellward.motion")

MAX_STATE_AGE_S = 0.1
FRESH_WITHIN_S = 0.2
_FRESH_TRIES = 4
LOOK_S = 0.5
TOOL_BACK, TOOL_BACK_S = "tool given back", 3.0
TAKE_UP_REST_S = 1.0
OWN_SCRIPT_OVER_S = 1.0


class Guard(Protocol):
    """What a motion guard checks before anything moves; each check raises a coded error.

    Ways are checked beside the event loop, which they would hold up for 10 to 30 ms.
    """

    def check_path_joints(self, q0: Array, q1: Array) -> None: ...
    def check_path_linear(
        self, T0: RigidTransform, T1: RigidTransform, q0: Array, speed_m_s: float | None = None
    ) -> None: ...
    def check_setpoints(self, Q: Array, Qd: Array) -> None: ...


class Recorder(Protocol):
    """Where a lease notes what it did."""

    def note(self, kind: str, **fields: Any) -> None: ...


@dataclass
class MotionBroker:
    """Lends each arm to one job at a time, and keeps it locked after a fault until someone resets."""

    clock: Clock
    latched: CellError | None = None
    _lent: set[str] = field(default_factory=set)

    def lease(
        self,
        arm: Arm,
        guard: Guard,
        tool: ToolSettings,
        speed: Speed,
        recorder: Recorder,
        tool_after: ToolSettings | None = None,
        steps: Interruptions | None = None,
    ) -> "MotionLease":
        """``async with broker.lease(...) as lease`` gives something that can move the arm.

        ``tool_after``: what the controller gets when the lease ends, for one whose ``tool`` is only tried.
        ``steps``: a move that a short silence interrupts is a step of these; without them it just fails.
        """
        return MotionLease(self, arm, guard, tool, speed, recorder, tool_after, steps)

    def acquire(self, arm: Arm) -> None:
        if self.latched is not None:
            raise error("MOTION_LATCHED", f"the last fault was: {self.latched}")
        if arm.name in self._lent:
            raise error("MOTION_BUSY", arm.name)
        self._lent.add(arm.name)

    def release(self, arm: Arm) -> None:
        self._lent.discard(arm.name)

    async def first_fault(self, arm: Arm, ignoring: Container[str] = ()) -> Exception:
        """Block until a package of the arm shows a fault that a job must end for; return its coded error.

        Faults whose names are in ``ignoring`` are somebody else's business.

        Local mode counts only while the arm is lent: between leases a person may jog it, to reach the board
        for instance, and the next lease refuses an arm that is still in local mode.
        """
        found: asyncio.Future[Exception] = asyncio.get_running_loop().create_future()

        def look(_: Sample[ArmState] | None = None) -> None:
            fault = arm.fault()
            if fault is None or found.done() or (isinstance(fault, CellError) and fault.name in ignoring):
                return
            if arm.name in self._lent or not isinstance(fault, CellError) or fault.name != "ARM_LOCAL_MODE":
                found.set_result(fault)

        unsubscribe = arm.state.subscribe(look)
        try:
            look()
            return await found
        finally:
            unsubscribe()

    def latch(self, fault: CellError) -> None:
        """Refuse motion until :meth:`reset`; the first fault stays."""
        self.latched = self.latched or fault

    def reset(self) -> None:
        self.latched = None


class MotionLease:
    """Something that can move the arm, for the length of one ``async with`` block.

    Leaving the block for any reason runs the stop ladder to its end: decelerate (0.5 s), end the motion
    client and run a stop script (1 s), dashboard stop (2 s), and then lock motion. A step counts only when
    the measured speed stays under the limit.
    """

    def __init__(
        self,
        broker: MotionBroker,
        arm: Arm,
        guard: Guard,
        tool: ToolSettings,
        speed: Speed,
        recorder: Recorder,
        tool_after: ToolSettings | None = None,
        steps: Interruptions | None = None,
    ) -> None:
        self._broker, self._arm, self._guard = broker, arm, guard
        self._tool, self._speed, self._recorder = tool, speed, recorder
        self._tool_after = tool_after
        self._steps = steps
        self._where_left = WhereLeft(speed.joint_rad_s)
        self._epoch_left: int | None = None  # of the arm's states, when it was left first in a row
        self._programs: ProgramWatch | None = None  # since then; None after an opening of ours that failed
        self._unseen = False  # our script ended unseen, and nobody was told yet
        self._port: MotionPort | None = None
        self.tool_given_back = False  # ``tool_after`` was set and read back

    async def __aenter__(self) -> Self:
        self._broker.acquire(self._arm)
        begun = ours = False  # ours: a client of ours was started, in this attempt or in an earlier one

        async def begin() -> None:
            nonlocal begun, ours
            port, self._port = self._port, None
            if port is not None:  # opened at last when a device was lost: the step is taken again
                self._unseen = self._unseen or port.ended_unseen
                await self._close(port)
            self._arm.check_movable()
            if not begun:
                self._recorder.note("motion", event="lease", arm=self._arm.name)
            begun = True
            try:
                self._port = await self._arm.open_motion(self._tool)
            except RefusedError:
                raise  # nothing of ours runs on the arm, of this attempt
            except BaseException:
                ours = ours or self._arm.motion_begun
                raise
            self._tell_unseen()

        try:
            await self._step("lease of the arm", begin)
        except BaseException:
            if not begun:
                self._broker.release(self._arm)
            elif not ours and self._port is None:
                # Nothing of ours was started, so there is nothing to stop; what others run stays untouched.
                self._broker.release(self._arm)
                self._note("motion", event="nothing begun", arm=self._arm.name)
            else:
                # The motion client may be half up, so its end is the ladder's business too.
                await run_to_its_end(self._end())
            raise
        if self._steps is not None:
            self._steps.arm = self
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, exc: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._steps is not None:
            self._steps.arm = None
        await run_to_its_end(self._end())

    async def move_joints(self, q: Array, speed: Speed | None = None) -> None:
        """Move in joint space to ``q`` (6,) rad; checked first, believed only when measured there."""
        target = np.asarray(q, dtype=float)
        await self._step("move", lambda: self._move_joints(target, speed or self._speed))

    async def move_linear(self, T_base_flange: RigidTransform, speed: Speed | None = None) -> None:
        """Move the tool on a line until the flange has this pose; checked first, measured after."""
        await self._step("linear move", lambda: self._move_linear(T_base_flange, speed or self._speed))

    async def _step(self, what: str, work: Callable[[], Awaitable[None]]) -> None:
        """A move is taken again from where an interruption ended it: the rest of the way that was checked."""
        await (work() if self._steps is None else self._steps.step(what, work))

    async def _move_joints(self, target: Array, speed: Speed) -> None:
        start = await self._movable_state()
        await asyncio.to_thread(self._guard.check_path_joints, start.q, target)
        await self._still_at(start.q)
        self._recorder.note("motion", event="move_joints", q=[round(float(v), 6) for v in target])
        with self._where_left.moving():
            await self._live_port().move_joints(target, speed.between(start.q, target))

    async def _move_linear(self, T_base_flange: RigidTransform, speed: Speed) -> None:
        start = await self._movable_state()
        line = start.T_base_flange, T_base_flange, start.q, speed.tcp_m_s
        await asyncio.to_thread(self._guard.check_path_linear, *line)
        await self._still_at(start.q)
        self._recorder.note("motion", event="move_linear", to=[float(v) for v in T_base_flange.translation])
        with self._where_left.moving():
            await self._live_port().move_linear(T_base_flange, speed)

    async def guarded_move(
        self,
        T_base_flange: RigidTransform,
        max_force_n: float,
        max_travel_m: float,
        speed: Speed | None = None,
    ) -> bool:
        """Linear move that a force ends; True when it did."""
        start, speed = await self._movable_state(), speed or self._speed
        line = start.T_base_flange, T_base_flange, start.q, speed.tcp_m_s
        await asyncio.to_thread(self._guard.check_path_linear, *line)
        await self._still_at(start.q)
        self._recorder.note("motion", event="guarded_move", max_force_n=max_force_n)
        with self._where_left.moving():
            return await self._live_port().guarded_move(T_base_flange, speed, max_force_n, max_travel_m)

    async def stream(self, pieces: AsyncIterator[TrajectoryPiece]) -> None:
        """Follow polynomials; five points of every piece pass the guard before it is sent.

        ``ARM_SPEED_SCALED`` below the controller's full speed, at the begin or on the way;
        ``ARM_NOT_FOLLOWING`` when the arm is not on the way that was sent.
        """
        require_full_speed(self._arm.name, await self._movable_state())
        self._recorder.note("motion", event="stream")
        guarded = self._guarded(pieces)
        try:
            with self._where_left.moving():
                await self._live_port().stream(guarded)
        finally:  # a cancel may find the port between two pieces; after a second one it still runs to its end
            if isinstance(guarded, AsyncGeneratorType) and not guarded.ag_running:
                await guarded.aclose()

    async def _guarded(self, pieces: AsyncIterator[TrajectoryPiece]) -> AsyncIterator[TrajectoryPiece]:
        following = Following(self._arm.name, self._arm.state)
        try:
            async for piece in pieces:
                self._guard.check_setpoints(*along(piece))
                following.sent(piece)
                yield piece
        finally:  # who makes the pieces ends now, not when somebody collects the garbage
            if isinstance(pieces, AsyncGenerator):
                await pieces.aclose()

    # -- after a short silence

    def leave(self) -> bool:
        """Whether the link to the arm is lost; if so, where the arm was seen last is remembered."""
        fault = self._arm.fault()
        lost = isinstance(fault, CellError) and fault.name in SILENCES
        if lost:
            self._note_left()
        return lost

    def _note_left(self) -> None:
        self._where_left.leave(self._arm.state.last())
        if self._epoch_left is None:
            self._epoch_left = self._arm.state.epoch
            self._programs = ProgramWatch(self._arm)

    async def rest(self) -> None:
        """The first step of the stop ladder, at once; :meth:`take_up` waits for the measured standstill.

        Where that fails the motion client ends, so that the controller's watchdog stops the arm: it must not
        go on to its target unseen.
        """
        self._note_left()
        if (port := self._port) is None:
            return
        if not await self._attempt("decelerate", port.decelerate, 0.5):
            # Not forgotten: it is asked whose end it was before another one is opened.
            await self._close(port)

    async def take_up(self) -> None:
        """Go on after an interruption: the arm rests where it was left, and nobody else has it.

        A port of ours that ended is opened again. ``ARM_MOVED`` when the arm was moved meanwhile,
        ``MOTION_NOT_STOPPED`` when it does not rest, ``STALE_DATA`` when its states do not tell, else the
        errors of :meth:`~cell.devices.Arm.open_motion`.
        """
        if not await measured_standstill(self._arm, TAKE_UP_REST_S):
            newest = self._arm.state.latest(MAX_STATE_AGE_S)  # silent again: another interruption
            if newest.value.at_rest:  # and so are states that came back too late to show rest for long enough
                raise error("STALE_DATA", f"{self._arm.name} was silent while it was seen to be at rest")
            raise error("MOTION_NOT_STOPPED", f"{self._arm.name} after a short silence")
        resting = self._arm.state.latest(MAX_STATE_AGE_S)
        here = resting.value.q
        self._where_left.found(self._arm.name, resting)
        if self._programs is not None and self._programs.began:
            raise error("ARM_PROGRAM_RUNNING", f"another one began on {self._arm.name} in the silence")
        if self._port is None or not self._port.usable:
            port, self._port = self._port, None
            self._unseen = self._unseen or self._arm.state.epoch != self._epoch_left
            if port is not None:
                self._unseen = self._unseen or port.ended_unseen
                await self._close(port)
            # Ours ends by its watchdog after the last kick; one that goes on is another's, and is refused.
            await program_ended(self._arm, OWN_SCRIPT_OVER_S)
            self._forget_programs()  # from here on one that begins is ours
            self._port = await self._arm.open_motion(self._tool)
            self._recorder.note("motion", event="opened again", arm=self._arm.name)
            self._tell_unseen()
        self._arm.check_movable()
        moved = float(np.max(np.abs(self._arm.state.latest(MAX_STATE_AGE_S).value.q - here)))
        if moved > STAYED_RAD:
            raise error(
                "ARM_MOVED", f"{self._arm.name}: a joint turned by {moved:.4f} rad while nothing was asked"
            )
        self._epoch_left = None
        self._forget_programs()

    def _forget_programs(self) -> None:
        if self._programs is not None:
            self._programs.close()
        self._programs = None

    def _tell_unseen(self) -> None:
        """A person answers for an end of our script that nobody saw, however often opening it was tried."""
        if self._unseen and self._steps is not None:
            self._steps.ask(f"no states of {self._arm.name} came when its script ended: why is unknown")
        self._unseen = False

    def _live_port(self) -> MotionPort:
        if self._port is None:
            raise error("INTERNAL", "a motion lease was used outside its block")
        return self._port

    async def _movable_state(self) -> ArmState:
        """The arm's state now; a short silence is waited out, motion never begins on an old state."""
        tries = _FRESH_TRIES
        while True:
            try:
                self._arm.check_movable()
                return self._arm.state.latest(MAX_STATE_AGE_S).value
            except CellError as exc:
                tries -= 1
                if exc.name != "STALE_DATA" or not tries:
                    raise
            await self._arm.wait_fresh(FRESH_WITHIN_S)  # on a busy machine it may be old again when we run

    async def _still_at(self, q: Array) -> None:
        """Checking a path took a while: the arm can be moved now, and is where the path begins."""
        now = await self._movable_state()
        moved = float(np.max(np.abs(now.q - q)))
        if moved > STAYED_RAD:
            raise error(
                "ARM_MOVED", f"{self._arm.name}: a joint turned by {moved:.4f} rad while its path was checked"
            )

    async def _end(self) -> None:
        port, self._port = self._port, None
        self._forget_programs()
        try:
            await self._stop_ladder(port)
            if self._tool_after is not None:
                await self._give_tool_back(port, self._tool_after)
        finally:
            if port is not None:
                await self._close(port)
            self._broker.release(self._arm)

    async def _give_tool_back(self, port: MotionPort | None, tool: ToolSettings) -> None:
        """At rest: whoever moves the arm next must not do it with a tool that was only tried."""

        async def give() -> None:
            if port is None:
                raise error("NOT_NOW", "there is no motion client")
            self._arm.check_movable()
            await port.set_tool(tool)
            self.tool_given_back = True

        await self._attempt(TOOL_BACK, give, TOOL_BACK_S)
        held = tool if self.tool_given_back else self._tool
        tcp = [round(float(v), 9) for v in to_pose6(held.T_flange_tool)]
        self._note("motion", event=TOOL_BACK, done=self.tool_given_back, controller_tcp=tcp)

    async def _stop_ladder(self, port: MotionPort | None) -> None:
        if port is None and await self._nothing_runs():
            # Nothing of ours is left to stop; a stop script would end what others start.
            self._note("motion", event="standstill", after="no motion")
            return
        steps: list[tuple[str, Callable[[], Awaitable[None]] | None, float]] = [
            ("decelerate", port.decelerate if port is not None else None, 0.5),
            ("stop script", self._arm.stop_script, 1.0),
            ("dashboard stop", self._arm.stop_program, 2.0),
        ]
        for name, action, budget in steps:
            if action is None:
                continue
            deadline = self._broker.clock.now() + budget
            await self._attempt(name, action, budget)
            # A step that used up its budget still gets one look at the arm.
            if await measured_standstill(self._arm, max(deadline - self._broker.clock.now(), 0.1)):
                self._note("motion", event="standstill", after=name)
                return
        failure = error("MOTION_NOT_STOPPED", f"{self._arm.name} after every step of the stop ladder")
        self._broker.latch(failure)
        self._note("error", **failure.as_dict())
        raise failure

    async def _nothing_runs(self) -> bool:
        """The arm rests and its newest state shows no program."""
        if not await measured_standstill(self._arm, LOOK_S):
            return False
        newest = self._arm.state.last()
        return newest is not None and not newest.value.program_running

    async def _close(self, port: MotionPort) -> None:
        """End a motion client, however often we are cancelled meanwhile: half closed it is lost for good."""

        async def close() -> None:
            await self._attempt("close", port.close, 3.0)

        await run_to_its_end(close())

    async def _attempt(self, name: str, action: Callable[[], Awaitable[None]], budget: float) -> bool:
        """One step with a deadline; its failure is noted and the next step follows. Whether it succeeded."""
        try:
            async with asyncio.timeout(budget):
                await action()
        except Exception as exc:
            self._note("motion", event="step failed", step=name, why=f"{type(exc).__name__}: {exc}")
            return False
        return True

    def _note(self, kind: str, **fields: Any) -> None:
        """A line about stopping; a disk that takes none must not keep the next step from being taken."""
        try:
            self._recorder.note(kind, **fields)
        except CellError as exc:
            log.error("%s: not in the journal (%s): %s", self._arm.name, exc, fields)
