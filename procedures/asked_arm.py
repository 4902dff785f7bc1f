"""An arm that its own program or an operator moves, asked by a job, and seen at rest."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from typing import Protocol

import numpy as np

from cell.devices import JointState
from cell.errors import CellError, error
from cell.poses import Array
from cell.procedure import Run
from cell.samples import Sample

LOOK_S = 0.05
REST_TIMEOUT_S = 10.0
MOST_REQUESTS = 0xFFFF


class Asking(Protocol):
    """How long a job waits for such an arm: a key of its own config."""

    @property
    def request_timeout_s(self) -> float: ...


class AskedArm:
    """``[robot] observed_arm``: its own program or an operator moves it, asked by us.

    A request is answered by the number that the arm's program shows. Without that handshake a person is asked
    to move the arm and to confirm. Either way only joints that were read after the request count.
    """

    def __init__(self, run: Run, config: Asking) -> None:
        self._run, self._config, self._arm = run, config, run.observed_arm()
        self.name = self._arm.name
        self._asked_t = -np.inf
        self._number = 0

    @asynccontextmanager
    async def session(self) -> AsyncIterator[None]:
        try:
            yield
        except BaseException:
            try:
                await self._take_back()
            except CellError as failure:
                with suppress(CellError):  # what failed first is the reason
                    self._run.note("error", event="request not taken back", **failure.as_dict())
            raise
        await self._run.take_step("take the request back", self._take_back)

    async def _take_back(self) -> None:
        if self._number:
            await self._arm.request(0, self.now())

    async def ask_for(self, q: Array, what: str, decimals: int = 2) -> None:
        """Ask for the joints ``q`` (j,); return when it rests, there or as near as its own program takes it.

        A person is told them in degrees with so many ``decimals``. ``OBSERVED_ARM_NOT_THERE`` when the arm
        does not say in time that it has come there.
        """
        clock = self._run.clock
        newest = self._arm.joints.last()
        shown = 0 if newest is None else newest.value.at_pose or 0
        # A number that it shows already would answer nothing; the arm has 16 bits for it.
        self._number = 1 + max(self._number, shown) % MOST_REQUESTS
        self._asked_t = clock.now()
        if not await self._arm.request(self._number, q):
            self._number = 0
            await self._run.ask(
                f"{what}: move {self.name} to {_joints_text(q, decimals)} and let it rest, then confirm."
            )
            await self.rest()
            return
        give_up = clock.now() + self._config.request_timeout_s
        while not ((state := self._fresh()) and state.at_rest and state.at_pose == self._number):
            if clock.now() > give_up:
                raise error("OBSERVED_ARM_NOT_THERE", self._missed(what))
            await clock.sleep(LOOK_S)

    def _fresh(self) -> JointState | None:
        """What was read since the request."""
        sample = self._sample()
        return sample.value if sample is not None and self._since_asked(sample) else None

    def _sample(self) -> Sample[JointState] | None:
        return self._arm.joints.last()

    def _missed(self, what: str) -> str:
        state = self._fresh()
        limit = f"within {self._config.request_timeout_s:g} s"
        if state is None:
            return f"{what}: {self.name} gave no joints {limit}"
        shows = "no number" if state.at_pose is None else f"number {state.at_pose}"
        moves = "at rest" if state.at_rest else "still moving"
        return f"{what}: {self.name} is {moves} and shows {shows}, not {self._number}, {limit}"

    async def rest(self) -> None:
        clock = self._run.clock
        give_up = clock.now() + REST_TIMEOUT_S
        while not ((state := self._fresh()) and state.at_rest):
            if clock.now() > give_up:
                found = "gave no joints since it was asked" if state is None else "still moves"
                raise error("POSE_UNSTABLE", f"{self.name} {found}, after {REST_TIMEOUT_S:g} s")
            await clock.sleep(LOOK_S)

    def now(self) -> Array:
        sample = self._sample()
        if sample is None:
            raise error("STALE_DATA", f"{self.name} has given no joints yet")
        return sample.value.q

    def joints(self, t0: float, t1: float) -> Array:
        samples = self._arm.joints.between(t0, t1)
        if self._arm.period_s is None:
            # It writes its joints once it rests: what it wrote last holds, unless it wrote again since.
            stream = self._arm.joints
            samples = stream.between(-np.inf, t0)[-1:] + stream.between(t0, np.inf)
        samples = [s for s in samples if self._since_asked(s)]
        if not samples:
            raise error("STALE_DATA", f"{self.name} gave no joints while its reflector was measured")
        if any(not s.value.at_rest for s in samples):
            raise error("POSE_UNSTABLE", f"{self.name} moved while its reflector was measured")
        return np.array([s.value.q for s in samples])

    def _since_asked(self, sample: Sample[JointState]) -> bool:
        return sample.t - sample.dt > self._asked_t


def _joints_text(q: Array, decimals: int) -> str:
    return ", ".join(f"{np.degrees(v):.{decimals}f}" for v in q) + " deg"
