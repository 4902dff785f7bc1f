"""The gripper's command under way, beside the stream of set-points."""

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any

from cell.clock import Clock
from cell.devices import Gripper
from cell.errors import error, present
from procedures.belt.motion.gripper_times import GripperTimes

STUCK = "the confirm input stays on after the gripper was opened"
HOLDING_AGE_S = 0.1


class GripperWork:
    """One command at a time: a new one ends the one before. Each is given when the arm is where it belongs,
    at a time of the cell's clock: the stream decides earlier than that, by what the arm is late."""

    def __init__(self, gripper: Gripper, clock: Clock, timeout_s: float, times: GripperTimes) -> None:
        self._gripper, self._clock, self._timeout_s = gripper, clock, timeout_s
        self._times = times
        self._task: asyncio.Task[bool] | None = None

    def begin_grip(self, t: float) -> None:
        self._begin(t, self._gripper.grip, closing=True)

    def begin_release(self, t: float) -> None:
        self._begin(t, self._gripper.release, closing=False)

    def holding(self) -> bool:
        """Whether the gripper holds something now."""
        return self._gripper.holding(HOLDING_AGE_S)

    def answer(self) -> bool | None:
        """What the last command came to; None while the gripper works."""
        task = present(self._task, "command that the gripper works on")
        return task.result() if task.done() else None

    def opened(self) -> bool:
        """Whether the gripper is open, by its own answer. ``GRIPPER_STUCK`` when it does not get so."""
        if (free := self.answer()) is False:
            raise error("GRIPPER_STUCK", STUCK)
        return free is True

    async def end(self) -> None:
        """Cancel what is under way."""
        task, self._task = self._task, None
        if task is not None and not task.done():
            task.cancel()
            await asyncio.wait([task])  # not awaited itself: a cancelled stream must not take it for its own

    def _begin(self, t: float, command: Callable[[float], Coroutine[Any, Any, bool]], closing: bool) -> None:
        async def give() -> bool:
            await self._clock.sleep(max(t - self._clock.now(), 0.0))
            begun = self._clock.now()
            if done := await command(self._timeout_s):
                self._times.add(closing, self._clock.now() - begun)
            return done

        if self._task is not None and not self._task.done():
            self._task.cancel()
        self._task = asyncio.create_task(give(), name="gripper")
