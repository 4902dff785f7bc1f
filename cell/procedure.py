"""The core that every job shares: states, checkpoints, prompts, and three ways out.

A procedure is one linear coroutine with a state enum, a transition table and a set of checkpoints. The
:class:`Run` it is given carries everything it may touch: devices by role, values resolved at the start,
the motion lease, the journal, the run folder, and the worker that computes away from the loop.
"""

import asyncio
from abc import ABC, abstractmethod
from collections.abc import Awaitable, Callable, Mapping, Sequence
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any, ClassVar, Protocol, TypeVar

from pydantic import BaseModel

from cell.clock import Clock
from cell.devices import ArmState, Device
from cell.errors import CellError, error
from cell.formats.result import NO_FIGURES, Envelope, Figures
from cell.interruptions import Interruptions
from cell.modelled_arm import ArmModels
from cell.motion import MotionLease
from cell.packml import PackML
from cell.run_devices import RunDevices
from cell.run_values import RunValues
from cell.samples import GAP_S
from cell.traces import Trace

R = TypeVar("R")

FRESH_S = 0.1  # an arm's state that tells where it stands now
SILENT_S = 0.5  # without a state at the end of a step: a silence, and no late sample


class FinishRequested(Exception):
    """Raised at a checkpoint after ``finish``: keep the data, go on to the end of the job."""


class Worker(Protocol):
    """Computes away from the loop. ``fn`` is a module-level function, arguments can be pickled."""

    async def call(self, fn: Callable[..., R], *args: Any, **kwargs: Any) -> R: ...


class Cell(Protocol):
    """What the daemon injects into a run."""

    clock: Clock
    worker: Worker

    def device(self, role: str) -> Device:
        """The device that plays ``role`` in ``[robot]``; ``DEVICE_NOT_READY`` when it is not READY."""
        ...

    def interruptions(self, run: "Run") -> Interruptions:
        """What takes the steps of ``run``, and takes one again after a short silence of a device."""
        ...

    def motion(
        self, run: "Run", tool: Mapping[str, Any] | None = None
    ) -> AbstractAsyncContextManager[MotionLease]:
        """The lease on the arm with the run's limits and guard, and ``tool`` or else the run's tool."""
        ...

    async def propose(self, run: "Run", proposal: "Proposal", result: Envelope) -> int:
        """Enter a proposed calibration in the ledger; returns its number."""
        ...

    async def accept(self, run: "Run", result_id: int, who: str, *, commit: bool) -> None:
        """Accept a proposed calibration; with ``commit`` it takes effect at once."""
        ...

    async def commit(self, run: "Run", result_id: int) -> None:
        """Put an accepted calibration into effect."""
        ...

    async def reject(self, run: "Run", result_id: int, why: str) -> None:
        """Turn a calibration down that is not in effect yet."""
        ...

    async def add_trend(self, name: str, value: float) -> list[tuple[float, float]]:
        """Keep one health number; returns its history of (wall time in s, value), oldest first."""
        ...

    async def add_item(
        self, run: "Run", item: int, t: float, outcome: str, detail: Mapping[str, Any]
    ) -> None:
        """Keep what became of one item that the job handled at ``t``, in the ledger."""
        ...


class Notebook(Protocol):
    """Where a run writes: a journal on disk."""

    def note(self, kind: str, **fields: Any) -> None: ...
    def check_on_disk(self) -> None: ...


@dataclass(frozen=True)
class Proposal:
    """A calibration that a finished job offers.

    ``name`` is its name in the ledger, ``value`` what takes effect, plain or as a model (of a large one that
    is dumped where it is stored), ``auto`` whether a passing result is accepted without a person.
    """

    name: str
    value: Any
    auto: bool


class Procedure(ABC):
    """One job. Subclasses set the class variables and write ``run``."""

    name: ClassVar[str]
    number: ClassVar[int]
    kind: ClassVar[str] = ""  # of its results and plans
    Config: ClassVar[type[BaseModel]]
    State: ClassVar[type[StrEnum]]
    TRANSITIONS: ClassVar[Mapping[Any, frozenset[Any]]]  # None: before the first state, after a last one
    CHECKPOINTS: ClassVar[frozenset[Any]]
    decides: ClassVar[bool] = False  # about what it proposed, itself and before it ends
    # Keys that a section takes from those of other jobs when it does not give them itself.
    inherits: ClassVar[Mapping[type["Procedure"], tuple[str, ...]]] = {}
    reads_reference: ClassVar[bool] = False  # of the tool, by laser-reference; also without beams of its own
    judges_arm: ClassVar[bool] = False  # it looks at the arm as its controller believes it, calibrated or not

    def __init__(self, config: Any) -> None:
        self.config = config

    @abstractmethod
    def uses(self) -> tuple[str, ...]:
        """Roles of ``[robot]`` that the job needs; it fails when one of them drops."""

    def check(self, values: RunValues) -> None:  # noqa: B027, most jobs name nothing
        """``ARGUMENT_INVALID`` when the parameters name something that ``values`` do not have."""

    def proposal(self, run: "Run") -> Proposal | None:
        """What a job that ended well proposes; not asked when the verdict is ``fail``."""
        return None

    def pictures(self) -> tuple[str, int]:
        """A camera's role, and how many pictures of it a run keeps that takes each at the first attempt."""
        return "", 0

    @abstractmethod
    async def run(self, run: "Run") -> None:
        """Do the job; return normally only when it is finished."""

    @abstractmethod
    async def dry_run(self, run: "Run") -> dict[str, Any]:
        """The plan without moving anything: a JSON-able list of poses with every check."""

    @classmethod
    def solve_again(cls, path: Path, info: Mapping[str, Any], recorded: Mapping[str, Any]) -> Envelope:
        """The result from the data set ``path``, solved and judged as the run did; ``info`` is its
        ``run.json``, ``recorded`` its result document."""
        raise error("NOT_FOUND", f"a {cls.name} has nothing to solve again")


class Run(RunDevices):
    """One execution of a procedure."""

    def __init__(
        self,
        run_id: int,
        procedure: Procedure,
        cell: Cell,
        folder: Path,
        notebook: Notebook,
        values: RunValues,
        publish: Callable[[], None] = lambda: None,
        adopted: Path | None = None,
        arm_models: ArmModels | None = None,
    ) -> None:
        """``arm_models``: how the arm is seen and moved when not as its controller believes."""
        self.id, self.procedure, self.cell, self.folder = run_id, procedure, cell, folder
        super().__init__(cell.device, values, arm_models)
        self.adopted = adopted
        self.clock, self.worker = cell.clock, cell.worker
        self.proposed: set[str] = set()  # names of the calibrations that it offered
        self.state: StrEnum | None = None
        self.packml = PackML.STARTING
        self.step, self.steps = 0, 0
        self.prompt: tuple[int, str] | None = None
        self.skippable = False  # what the prompt asks for may be left out
        self.result: Envelope | None = None
        self.answered = False  # its data set holds the answer already, should it end in whatever way
        self.figures: Figures = NO_FIGURES  # of the result, for registers
        self.shown: dict[str, Any] | None = None  # what is short of it, for a status
        self.visited: list[tuple[StrEnum | None, StrEnum]] = []
        self.live: dict[str, float] = {}  # numbers of now, by the names of registers
        self.traces: dict[str, Trace] = {}
        self._notebook, self._publish = notebook, publish
        self.work_wanted = True  # no new item is begun while it is not
        self.steered = False  # somebody held it, finished it early, or answered a question of it
        self._finish = False
        self._hold_wanted = False
        self._released = asyncio.Event()
        self._answered = asyncio.Event()
        self._prompts = 0
        self._skipped = False
        self.steps_taken = cell.interruptions(self)

    # -- what a procedure calls

    async def take_step(self, what: str, work: Callable[[], Awaitable[R]], *, measures: bool = True) -> R:
        """Do ``work``, which can be taken again from wherever the arm was stopped, with all it measures.

        After a short silence of a device it is: the job is then in the state in which the step began. One
        that ``measures`` counts as interrupted by a gap in the arm's state, too; and when it began at a
        checkpoint and somebody asked to finish meanwhile, it is not taken again. ``what`` names the step in
        the journal and in the result.
        """
        state, taken = self.state, False

        async def again() -> R:
            nonlocal taken
            self.state, began = state, self.clock.now()
            if taken and measures and self._finish and state in self.procedure.CHECKPOINTS:
                raise FinishRequested
            taken = True
            result = await work()
            if measures:
                await self._require_unbroken(began)
            return result

        return await self.steps_taken.step(what, again)

    async def arm_state(self) -> ArmState:
        """The arm's state of now; a short silence of it is waited out."""

        async def look() -> ArmState:
            return self.arm().state.latest(FRESH_S).value

        return await self.take_step("look at the arm", look)

    async def enter(self, state: StrEnum, why: str = "", **fields: Any) -> None:
        """Take the transition to ``state``: checked, written to the journal, published; the pause gate."""
        allowed = self.procedure.TRANSITIONS.get(self.state, frozenset())
        if state not in allowed:
            raise error("INTERNAL", f"{self.procedure.name}: no transition from {self.state} to {state}")
        self.visited.append((self.state, state))
        self.state = state
        self.packml = PackML.HOLDING if self._hold_wanted else PackML.EXECUTE
        self.note("state", state=state.value, why=why, **fields)
        self._publish()
        if state in self.procedure.CHECKPOINTS:
            await self._gate()

    async def _require_unbroken(self, since: float) -> None:
        if "arm" not in self.procedure.uses():
            return
        arm = self.arm()
        newest = arm.state.last()
        if newest is None or self.clock.now() - newest.t > GAP_S:  # a silence that lasts is no gap yet
            try:
                await arm.wait_fresh(SILENT_S)
            except CellError as exc:
                raise error("STALE_DATA", f"{arm.name} is silent at the end of the step") from exc
        gap = arm.state.last_gap
        if gap is not None and gap[1] > since:
            raise error("STALE_DATA", f"the arm gave no state for {gap[1] - gap[0]:.3f} s within the step")

    async def ask(self, text: str, *, skippable: bool = False) -> bool:
        """Hold with the arm at rest until an operator confirms this prompt; False when what a ``skippable``
        one asks for was skipped."""
        if self._finish:
            raise FinishRequested
        self._prompts += 1
        prompt_id = self.id % 65536 * 65536 + self._prompts
        self.prompt, self.skippable, self._skipped = (prompt_id, text), skippable, False
        self._answered.clear()
        self.note("operator", event="prompt", prompt=prompt_id, text=text)
        self._set_packml(PackML.HELD)
        try:
            await self._answered.wait()
        finally:
            self.prompt = None
        if self._finish:
            raise FinishRequested
        self._set_packml(PackML.HOLDING if self._hold_wanted else PackML.EXECUTE)
        return not self._skipped

    @property
    def wants_finish(self) -> bool:
        """Whether someone asked to finish: for a job that has something to do before it ends."""
        return self._finish

    @property
    def wants_rest(self) -> bool:
        """Whether someone asked to pause or to finish: a job that streams goes to a checkpoint."""
        return self._hold_wanted or self._finish

    def suspend(self, why: str) -> None:
        """Wait for something outside, with the arm at rest: no parts, a belt that stands."""
        self.note("decision", event="suspended", why=why)
        self._set_packml(PackML.SUSPENDED)

    def unsuspend(self) -> None:
        """What was waited for is there again."""
        self._set_packml(PackML.HOLDING if self._hold_wanted else PackML.EXECUTE)

    def show_interruption(self) -> None:
        """Suspended, for something outside, from an interruption of a step until it is taken again."""
        if self.steps_taken.waiting:
            self._set_packml(PackML.SUSPENDED)
        elif self.packml is PackML.SUSPENDED:
            self.unsuspend()

    def publish(self, **live: float) -> None:
        """Numbers of now for people and registers."""
        self.live.update(live)
        self._publish()

    def trace(self, name: str, columns: Sequence[str]) -> Trace:
        """Rows of the last while for whoever draws them; nobody is told when one is added."""
        return self.traces.setdefault(name, Trace(columns))

    def progress(self, step: int, steps: int) -> None:
        """How far the job is, for people and registers."""
        self.step, self.steps = step, steps
        self._publish()

    def note(self, kind: str, **fields: Any) -> None:
        """One journal line."""
        self._notebook.note(kind, **fields)

    def check_record(self) -> None:
        """``RUN_FOLDER_LOST`` when the run has lost its folder: nothing may be committed then."""
        self._notebook.check_on_disk()

    def motion(self, tool: Mapping[str, Any] | None = None) -> AbstractAsyncContextManager[MotionLease]:
        """``async with run.motion() as lease``: the only way to move.

        ``tool`` (as ``values.tool``) replaces the run's tool for this lease: a candidate that is tried.
        When the lease ends the controller gets the run's tool again.
        """
        return self.cell.motion(self, tool)

    # -- what the engine calls

    def confirm(self, prompt_id: int, who: str) -> None:
        """The operator says that what prompt ``prompt_id`` asked for is done."""
        self._answer("confirm", prompt_id, who)

    def skip(self, prompt_id: int, who: str) -> None:
        """The operator leaves out what prompt ``prompt_id`` asked for; the job goes on without it."""
        if self.prompt is not None and self.prompt[0] == prompt_id and not self.skippable:
            raise error("NOT_NOW", f"prompt {prompt_id} cannot be skipped: confirm it, or finish the job")
        self._answer("skip", prompt_id, who)

    def _answer(self, event: str, prompt_id: int, who: str) -> None:
        if self.prompt is None or self.prompt[0] != prompt_id:
            waiting = f"prompt {self.prompt[0]} is open" if self.prompt else "no prompt is open"
            raise error("NOT_NOW", f"prompt {prompt_id} is not open, {waiting}")
        self.note("operator", event=event, prompt=prompt_id, who=who)
        self.steered = True
        self.prompt, self._skipped = None, event == "skip"
        self._answered.set()

    def finish(self) -> None:
        """End at the next checkpoint and keep the data."""
        self._finish = self.steered = True
        self._answered.set()
        self.resume()

    def pause(self) -> None:
        """Hold at the next checkpoint."""
        self._hold_wanted = self.steered = True
        self._released.clear()
        if self.packml is not PackML.HELD:
            self._set_packml(PackML.HOLDING)

    def hold_for(self, why: str) -> None:
        """Hold before the arm moves again, until a person has seen to it."""
        self.note("decision", event="held for a person", why=why)
        self.pause()

    def resume(self) -> None:
        """Go on after :meth:`pause`; a prompt still waits for its answer."""
        self._hold_wanted = False
        self._released.set()
        if self.packml is PackML.HOLDING:
            self._set_packml(PackML.EXECUTE)

    def want_work(self, wanted: bool, who: str) -> None:
        """``False``: a job that goes item by item begins no new one until somebody wants it again."""
        if wanted != self.work_wanted:
            self.work_wanted = wanted
            self.note("operator", event="work wanted" if wanted else "no new work", who=who)

    def _set_packml(self, state: PackML) -> None:
        self.packml = state
        self.note("state", packml=state.name)
        self._publish()

    async def released(self) -> None:
        """Held, with the arm at rest, for as long as somebody wants that."""
        if not self._hold_wanted:
            return
        self._set_packml(PackML.HELD)
        await self._released.wait()
        self._set_packml(PackML.UNHOLDING)
        self._set_packml(PackML.EXECUTE)

    async def _gate(self) -> None:
        if self._finish:
            raise FinishRequested
        await self.released()
        if self._finish:
            raise FinishRequested
