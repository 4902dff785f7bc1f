"""Watching a motion on the arm's own state stream until it succeeds or something forbids it to go on."""

import asyncio
from collections.abc import Callable
from typing import Any, Protocol, Self

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from cell.answer_time import answer_within
from cell.devices import ArmState
from cell.errors import CellError, error
from cell.poses import Array
from cell.samples import GAP_S, Sample, Stream
from drivers.ur.config import UrConfig
from drivers.ur.framing import Message
from drivers.ur.motion_client import MotionClient
from drivers.ur.script_end import ScriptEnd, ScriptRecord

REST_SAMPLES = 5
# A move that has not left its start, or rests elsewhere, for this long is not going to arrive.
STUCK_S = 1.0
TOLD_LATE_S = 0.1

Judge = Callable[[Sample[ArmState]], Any]


_GONE = object()  # the script or the child ended; why is found out afterwards


class ArmView(Protocol):
    """What a watch needs of the arm: its stream, its coded fault, and the error that ended its link."""

    state: Stream[ArmState]

    @property
    def lost(self) -> CellError | None: ...

    def fault(self) -> CellError | None: ...


class Watch:
    """Judges every sample while a motion is under way.

    ``judge`` returns None to go on, or the outcome. Faults, the end of the control script, a lost link and a
    dead child end the watch with their coded error. Use as a context manager around the motion.
    """

    def __init__(self, arm: ArmView, client: MotionClient, judge: Judge, script: ScriptRecord) -> None:
        self._arm, self._client, self._judge, self._script = arm, client, judge, script
        self._outcome: asyncio.Future[Any] = asyncio.get_running_loop().create_future()
        self._refusal = "no program is running on the arm any more"
        self._undo: list[Callable[[], None]] = []

    def __enter__(self) -> Self:
        self._undo = [self._arm.state.subscribe(self._look), self._client.subscribe(self._hear)]
        return self

    def __exit__(self, *exc: object) -> None:
        undone, self._undo = self._undo, []  # no circle of references for the collector
        for undo in undone:
            undo()
        self._outcome.cancel()

    async def outcome(self, timeout: float, what: str) -> Any:
        """Wait for the judge's verdict; the coded error otherwise, ``CALL_TIMEOUT`` after ``timeout``."""
        try:
            async with answer_within(timeout):
                verdict = await asyncio.shield(self._outcome)
        except TimeoutError:
            late = error("CALL_TIMEOUT", f"{what} did not end in {timeout:.1f} s")
            raise await self._explained(late) from None
        if verdict is _GONE:
            raise await self._why_gone()
        if isinstance(verdict, CellError):
            raise await self._explained(verdict)
        return verdict

    async def first(self, work: asyncio.Future[Any], *ends: asyncio.Future[None]) -> bool:
        """Wait for ``work``, one of ``ends`` or the end of the watch; True when ``work`` was done first."""
        others = [*ends, self._outcome]
        await asyncio.wait([work, *others], return_when=asyncio.FIRST_COMPLETED)
        return work.done() and not any(other.done() for other in others)

    @property
    def over(self) -> bool:
        return self._outcome.done()

    def end(self, verdict: Any) -> None:
        """Settle the outcome unless it is settled."""
        if not self._outcome.done():
            self._outcome.set_result(verdict)

    def end_by_script(self, why: str) -> None:
        """The script did not take a command: it ended; why is found out as for any other end."""
        self._refusal = why
        self.end(_GONE)

    def _look(self, sample: Sample[ArmState]) -> None:
        if self._outcome.done():
            return
        fault = self._arm.fault()
        if fault is not None:
            self.end(fault)
        elif not sample.value.program_running:
            self.end(_GONE)
        else:
            verdict = self._judge(sample)
            if verdict is not None:
                self.end(verdict)

    def _hear(self, message: Message) -> None:
        if message["event"] == "died":
            self.end(_GONE)

    async def _explained(self, verdict: CellError) -> CellError:
        """``verdict``; where the arm rests elsewhere, or did not come, because our beat was late, that."""
        if verdict.name in ("ARM_NOT_AT_TARGET", "CALL_TIMEOUT"):
            await asyncio.sleep(TOLD_LATE_S)  # a loop that stood still reads what the child told last
            if self._client.withheld or self._script.end is ScriptEnd.OURS:
                return _watchdog("the daemon's beat" if self._client.withheld else "the motion client")
        return verdict

    async def _why_gone(self) -> CellError:
        """The script ended, or the child did. What explains it may be some milliseconds behind."""
        await asyncio.sleep(0.02)
        for _ in range(18):  # a command that was not accepted tells earlier than the next package
            if self._script.end is not ScriptEnd.NONE or self._client.ended.is_set():
                break
            await asyncio.sleep(0.01)
        fault = self._arm.lost or self._arm.fault()
        if fault is not None:
            return fault
        end = self._script.end
        if end is ScriptEnd.OTHERS:
            return error("ARM_SCRIPT_DIED", self._refusal)
        if self._client.ended.is_set():
            return self._client.death()
        if end is ScriptEnd.UNSEEN:
            return error("STALE_DATA", "our script ended while the arm gave no state")
        if end is ScriptEnd.OURS:
            return _watchdog("the daemon's beat" if self._client.withheld else "the motion client")
        return error("ARM_SCRIPT_DIED", self._refusal)


def _watchdog(who: str) -> CellError:
    return error("MOTION_WATCHDOG", f"{who} was late, so the watchdog was not kicked in time")


class _Arrival:
    """At rest at the target for a few samples; or at rest elsewhere for too long."""

    def __init__(self, started: float) -> None:
        self._resting_since = self._latest = started
        self._arrived = 0

    def judge(
        self, sample: Sample[ArmState], there: Callable[[ArmState], bool], away: Callable[[ArmState], str]
    ) -> Any:
        state, before, self._latest = sample.value, self._latest, sample.t
        if sample.t - before > GAP_S:  # what it did meanwhile was not seen
            self._resting_since, self._arrived = sample.t, 0
        if not state.at_rest:
            self._resting_since, self._arrived = sample.t, 0
            return None
        if there(state):
            self._arrived += 1
            return True if self._arrived >= REST_SAMPLES else None
        self._arrived = 0
        if sample.t - self._resting_since > STUCK_S:
            return error("ARM_NOT_AT_TARGET", away(state))
        return None


def joints_judge(target: Array, tolerance_rad: float, started: float) -> Judge:
    """True once the measured joints rest within ``tolerance_rad`` of ``target`` (6,)."""
    arrival = _Arrival(started)

    def distance(state: ArmState) -> float:
        return float(np.max(np.abs(state.q - target)))

    def away(state: ArmState) -> str:
        return f"the joints rest {distance(state):.4f} rad from their target, allowed {tolerance_rad:g} rad"

    return lambda sample: arrival.judge(sample, lambda s: distance(s) <= tolerance_rad, away)


def pose_judge(T_base_tcp: RigidTransform, tolerance_m: float, tolerance_rad: float, started: float) -> Judge:
    """True once the measured TCP rests within both tolerances of ``T_base_tcp``."""
    arrival = _Arrival(started)
    p, R = T_base_tcp.translation, T_base_tcp.rotation

    def errors(state: ArmState) -> tuple[float, float]:
        turn = (R.inv() * Rotation.from_rotvec(state.tcp_pose6[3:])).magnitude()
        return float(np.linalg.norm(state.tcp_pose6[:3] - p)), float(turn)

    def there(state: ArmState) -> bool:
        if np.linalg.norm(state.tcp_pose6[:3] - p) > tolerance_m:
            return False
        return errors(state)[1] <= tolerance_rad

    def away(state: ArmState) -> str:
        distance, turn = errors(state)
        return (
            f"the TCP rests {distance * 1e3:.2f} mm and {turn:.4f} rad from its target, "
            f"allowed {tolerance_m * 1e3:.2f} mm and {tolerance_rad:g} rad"
        )

    return lambda sample: arrival.judge(sample, there, away)


async def until(
    arm: ArmView,
    config: UrConfig,
    holds: Callable[[], bool],
    timeout: float,
    what: str,
    failure: str = "CALL_TIMEOUT",
) -> None:
    """Wait for a sample after which ``holds`` is true; ``failure`` when those of ``timeout`` s show none.

    ``STALE_DATA`` when no such samples come: a silence says nothing of what was waited for.
    """
    began = arm.state.clock.now()
    seen: asyncio.Future[bool] = asyncio.get_running_loop().create_future()

    def look(sample: Sample[ArmState]) -> None:
        late = sample.t + config.time_offset_s - began > timeout
        if not seen.done() and (holds() or late):
            seen.set_result(holds())

    undo = arm.state.subscribe(look)
    try:
        await asyncio.wait([seen], timeout=timeout + config.lost_after_s)
    finally:
        undo()
    if not seen.done():
        raise arm.lost or error("STALE_DATA", f"{what}: the arm gave no state in {timeout:g} s")
    if not seen.result():
        raise error(failure, f"{what} was not seen in {timeout:g} s")


async def drop(work: asyncio.Future[Any]) -> None:
    """Nobody waits for it any more, nor for what it failed with."""
    if not work.done():
        work.cancel()
        await asyncio.wait([work])
    if not work.cancelled():
        work.exception()
