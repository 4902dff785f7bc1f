"""A short silence of a device costs a step, not the run: the step is taken again, and that is told.

A step is a part of a job that can be taken again from wherever the arm was stopped: a move, a pass across a
beam, a pose. What a step measured while it was interrupted is not used. Safety events, a program that others
ended, an arm that was moved and a restart are not interruptions; they end the run.
"""

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from typing import Any, Protocol, TypeVar

from cell.clock import Clock
from cell.errors import CellError

R = TypeVar("R")

# Errors that a silence shows as. DEVICE_NOT_READY: the device was there when the run began.
SILENCES = frozenset(
    {
        "STALE_DATA",
        "DEVICE_LOST",
        "DEVICE_UNREACHABLE",
        "DEVICE_NOT_READY",
        "MOTION_WATCHDOG",
        "LASER_POLL_GAP",
    }
)


MARGIN_S = 1.0


@dataclass(frozen=True)
class InterruptionLimits:
    """How long a device may be silent, and how often, before the run ends.

    ``within_s``: from the last word before to the first one after, s. A device that has to be connected anew
    gets ``reconnect_s`` more.
    """

    within_s: float = 2.0
    reconnect_s: float = 1.5
    in_a_row: int = 3
    in_all: int = 10

    @property
    def until_lost_s(self) -> float:
        return self.within_s + self.reconnect_s


class Resting(Protocol):
    """What holds the arm of a run: stops it when a step is interrupted, and takes it up again."""

    def leave(self) -> bool:
        """Whether the link to the arm is lost; if so, where the arm was seen last is remembered."""
        ...

    async def rest(self) -> None:
        """Begin to stop, with the means of the moment; does not wait for the measured standstill."""
        ...

    async def take_up(self) -> None:
        """See the arm at rest where it was left, and be ready to move it again; else a coded error."""
        ...


async def _nobody_holds() -> None: ...


@dataclass
class Interruptions:
    """Takes the steps of one run.

    ``wait_devices`` returns when every device of the run is ready and fresh; ``paused`` tells for how long
    this process itself stood still at most since a time; ``note`` writes a journal line; ``told`` is called
    when something changed; ``released`` returns when nobody wants the run to hold. ``ask`` is told what a
    person has to answer for before the arm moves again, where the cell wants that. ``waiting`` is true from
    an interruption until all is as it was left; ``taken_again`` holds the steps that were begun again then.
    """

    clock: Clock
    wait_devices: Callable[[], Awaitable[None]]
    note: Callable[..., None]
    told: Callable[[], None] = lambda: None
    paused: Callable[[float], float] = lambda since: 0.0
    released: Callable[[], Awaitable[None]] = _nobody_holds
    limits: InterruptionLimits = InterruptionLimits()
    ask: Callable[[str], None] = lambda why: None
    arm: Resting | None = None  # while a lease holds it
    taken_again: list[dict[str, Any]] = field(default_factory=list)
    waiting: bool = False
    _step: asyncio.Task[Any] | None = None
    _cause: CellError | None = None
    _between: tuple[CellError, float] | None = None  # the arm was lost between two steps, and when
    _in_a_row: int = 0
    _in_all: int = 0

    async def step(self, what: str, work: Callable[[], Awaitable[R]]) -> R:
        """Do ``work``, and again after a short silence; ``what`` names it in the journal.

        A step within a step belongs to the outer one, which is taken again as a whole. The error that
        interrupted it ends the run when the silence was too long, or came too often.
        """
        if self._step is not None:
            return await work()
        while True:
            await self._take_up_after(what)  # also what was lost while the run was held
            began = self.clock.now()
            try:
                result = await self._take(work)
            except CellError as failure:
                cause = failure
            else:
                self._in_a_row = 0
                return result
            await self._recover_whole(what, cause, began)

    @property
    def in_a_row(self) -> int:
        """Interruptions since a step, or a part of one, was last done."""
        return self._in_a_row

    def part_done(self) -> None:
        """A part of a long step is done for good: an interruption of the next part begins a new row."""
        self._in_a_row = 0

    def bridges(self, fault: Exception) -> bool:
        """Whether a run may go on when a device that was lost with ``fault`` comes back in time."""
        return isinstance(fault, CellError) and fault.name in SILENCES and not self._spent(1)

    def interrupt(self, cause: CellError) -> None:
        """A device was lost: the step that is under way ends now; beside the steps it counts all the same.

        An arm that was lost between two steps is taken up before the next one: its script has ended.
        """
        if self._step is None:
            if self.waiting:
                return
            if self.arm is not None and self.arm.leave() and self._between is None:
                self._between = cause, self.clock.now()
            else:
                self._in_all += 1
        elif self._cause is None:
            self._cause = cause
            self._step.cancel()

    async def _take_up_after(self, what: str) -> None:
        """What was lost between the steps is back before ``what`` begins."""
        while (between := self._between) is not None:
            self._between = None
            if self.arm is not None:
                await self._recover_whole(what, *between)

    async def _recover_whole(self, what: str, cause: CellError | None, began: float) -> None:
        """Recover until nothing interrupts it; raises what is no silence."""
        while cause is not None:
            if cause.name not in SILENCES:
                raise cause
            cause = await self._recover(what, cause, began)

    async def _take(self, work: Callable[[], Awaitable[R]]) -> R:
        async def done() -> R:
            return await work()

        step: asyncio.Task[R] = asyncio.create_task(done(), name="step")
        self._step = step
        self._cause = None
        try:
            await _ended(step)
        finally:
            self._step = None
        if self._cause is not None:  # whatever it came to, a device was silent meanwhile
            if not step.cancelled():
                step.exception()
            raise self._cause
        return step.result()

    async def _recover(self, what: str, cause: CellError, began: float) -> CellError | None:
        """Stop, wait for the devices, see that all is as it was left; else ``cause`` ends the run.

        Returns what interrupted this as well, if anything did: the next one in a row.
        """
        struck = self.clock.now()
        if self._spent(1):
            self.note("error", event="interrupted too often", step=what, **cause.as_dict())
            raise cause
        self._in_a_row += 1
        self._in_all += 1
        entry = {"step": what, "cause": cause.name, "why": str(cause), "after_s": round(struck - began, 3)}
        self.waiting = True
        self.note("device", event="interrupted", **entry)
        self.told()
        try:
            if self.arm is not None:
                await self.arm.rest()
            await self._devices_back(cause)
            if self.paused(began) > self.limits.within_s:
                raise cause
            if self.arm is not None:
                await self.arm.take_up()
        except CellError as anew:
            if anew is cause:
                raise
            return anew
        finally:
            self.waiting = False
        entry["lost_s"] = round(self.clock.now() - struck, 3)
        self.taken_again.append(entry)
        self.note("decision", event="step taken again", step=what, lost_s=entry["lost_s"])
        self.told()
        await self.released()
        return None

    async def _devices_back(self, cause: CellError) -> None:
        # Whoever watches the devices ends the run first, by the name of what was lost.
        try:
            async with asyncio.timeout(self.limits.until_lost_s + MARGIN_S):
                await self.wait_devices()
        except TimeoutError:
            raise cause from None

    def _spent(self, more: int) -> bool:
        limits = self.limits
        return self._in_a_row + more >= limits.in_a_row or self._in_all + more >= limits.in_all


async def _ended(step: asyncio.Task[Any]) -> None:
    """Wait for ``step``; a cancel of ours becomes a cancel of it, and is raised when it has ended."""
    try:
        await asyncio.wait([step])
    except asyncio.CancelledError:
        step.cancel()
        while not step.done():
            try:
                await asyncio.wait([step])
            except asyncio.CancelledError:
                continue  # a lease within it runs its stop ladder to the end however often we are asked
        if not step.cancelled():
            step.exception()
        raise
