"""The two kinds of arms that can be sampled: one that we move, and one that we only read."""

from collections.abc import AsyncIterator
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from typing import Protocol

import numpy as np

from cell.errors import error, present
from cell.motion import MotionLease
from cell.poses import Array
from cell.procedure import Run
from cell.standstill import measured_standstill
from procedures.asked_arm import AskedArm
from procedures.tracker.plan import Visit
from procedures.tracker.states import State

STANDSTILL_TIMEOUT_S = 3.0
FRESH_S = 0.1


class SampledArm(Protocol):
    """What the job needs of an arm, whoever moves it."""

    name: str
    travel: State

    def session(self) -> AbstractAsyncContextManager[None]:
        """While it can be sent to poses; nobody may be near an arm that we move."""
        ...

    async def go(self, visit: Visit, what: str) -> None:
        """Return when it has got to the pose, or as near as its own program takes it."""
        ...

    async def rest(self) -> None:
        """Return when it is measured to be at rest; ``POSE_UNSTABLE`` else."""
        ...

    def now(self) -> Array:
        """(j,): the joints as they are."""
        ...

    def joints(self, t0: float, t1: float) -> Array:
        """(k, j): what was read of the joints from ``t0`` to ``t1``, at least one row."""
        ...


class LeasedArm:
    """``[robot] arm``: moved under the motion lease."""

    travel = State.MOVE

    def __init__(self, run: Run) -> None:
        self._run, self._arm = run, run.arm()
        self.name = self._arm.name
        self._lease: MotionLease | None = None

    @asynccontextmanager
    async def session(self) -> AsyncIterator[None]:
        async with self._run.motion() as lease:
            self._lease = lease
            try:
                yield
            finally:
                self._lease = None

    async def go(self, visit: Visit, what: str) -> None:
        lease = present(self._lease, "motion lease outside of a session")
        for q in (*visit.via, visit.q):
            await lease.move_joints(np.array(q))

    async def rest(self) -> None:
        if not await measured_standstill(self._arm, STANDSTILL_TIMEOUT_S):
            raise error("POSE_UNSTABLE", f"{self.name} did not come to rest in {STANDSTILL_TIMEOUT_S:g} s")

    def now(self) -> Array:
        return self._arm.state.latest(FRESH_S).value.q

    def joints(self, t0: float, t1: float) -> Array:
        rows = [s.value.q for s in self._arm.state.between(t0, t1)]
        if not rows:
            raise error("STALE_DATA", f"{self.name} gave no state while its reflector was measured")
        return np.array(rows)


class WatchedArm(AskedArm):
    """``[robot] observed_arm``: its own program or an operator moves it, asked by us."""

    travel = State.REQUEST

    async def go(self, visit: Visit, what: str) -> None:
        await self.ask_for(np.array(visit.q), what)
