"""A gripper that is asked again and again what it does: its link, its samples, waiting for one of them."""

import asyncio
from abc import abstractmethod
from collections.abc import Callable
from typing import Any, Generic, TypeVar

from pydantic import Field

from cell.clock import Clock
from cell.devices import Identity
from cell.errors import CellError, error
from cell.formats.reading import Strict
from cell.samples import GAP_S, Sample, Stream
from drivers.life import SampledDevice
from drivers.modbus.link import NoAnswer

State = TypeVar("State")


class PolledConfig(Strict):
    """Keys that such grippers share."""

    serial: str = Field(
        min_length=1,
        max_length=64,
        description="Of the gripper or module; it does not tell, so it is said here",
    )
    poll_period_s: float = Field(
        default=0.02, ge=0.002, le=1.0, description="Time between two questions what it does"
    )
    timeout_s: float = Field(default=0.2, ge=0.005, le=2.0, description="Longest wait for one reply")
    connect_timeout_s: float = Field(
        default=3.0, gt=0.0, le=15.0, description="longest wait for a connection, s"
    )
    lost_after_failures: int = Field(
        default=3, ge=1, le=50, description="Questions in a row without an answer that end the link"
    )


class PolledGripper(SampledDevice, Generic[State]):
    """What a kind of gripper adds: ``_connect``, ``_disconnect``, ``_ask`` and what its states mean.

    Neither connecting nor losing the link moves anything.
    """

    def __init__(self, name: str, config: PolledConfig, clock: Clock) -> None:
        self.states: Stream[State] = Stream(name, clock)
        super().__init__(name, clock, self.states)
        self._polled = config
        self._seq = self._failures = self._failures_in_a_row = 0

    @abstractmethod
    async def _connect(self) -> Identity:
        """Connect; ``DEVICE_UNREACHABLE``."""

    @abstractmethod
    async def _disconnect(self) -> None:
        """End the connection; harmless without one."""

    @abstractmethod
    async def _ask(self) -> State:
        """What it does now; ``NoAnswer``, or an error that ends the link."""

    @abstractmethod
    def _holds(self, state: State) -> bool:
        """Whether something is held."""

    @abstractmethod
    def _shown(self, state: State | None) -> dict[str, Any]:
        """For status pages; None while unknown."""

    # -- Device

    async def open(self) -> None:
        """Connect and ask once; ``DEVICE_UNREACHABLE``, or what the gripper says is wrong."""
        await self.close()
        self._life.begin()
        self.states.new_epoch()
        self._failures_in_a_row = 0
        try:
            self._identity = await self._connect()
            await self._look()
        except NoAnswer as exc:
            await self.close()
            raise error("DEVICE_UNREACHABLE", f"{self.name} connects, but gives {exc}") from exc
        except BaseException:
            await self.close()
            raise
        self._life.keep_going(self._poll(), "polling")

    async def close(self) -> None:
        """End polling and the connection; what is held stays held."""
        await self._life.end()
        await self._disconnect()

    def health(self) -> dict[str, Any]:
        """Age (s) of the newest answer, answers that were missing, and what it does."""
        last = self.states.last()
        good = last is not None and self._life.good
        return {
            "connected": self._life.good,
            "age_s": None if last is None else self._clock.now() - last.t,
            "failures": self._failures,
            **self._shown(last.value if good and last is not None else None),
        }

    # -- Gripper

    @property
    @abstractmethod
    def confirms(self) -> bool:
        """Whether anything tells that something is held."""

    def holding(self, max_age: float) -> bool:
        """Whether something is held, from an answer at most ``max_age`` s old; else ``STALE_DATA``."""
        self._life.require()
        return self._holds(self.states.latest(max_age).value)

    async def _becomes(self, wanted: Callable[[State], bool], timeout: float) -> bool:
        """Whether ``wanted`` is true of an answer to a question of now or later, within ``timeout`` s.

        Time runs with the answers, so that a pause of this machine does not use it up. What breaks the link
        is raised.
        """
        asked = began = before = self._clock.now()
        done: asyncio.Future[bool] = asyncio.get_running_loop().create_future()

        def look(sample: Sample[State]) -> None:
            nonlocal began, before
            if done.done() or sample.t - sample.dt < asked:
                return
            if sample.t - before > GAP_S:
                began = sample.t
            before = sample.t
            if wanted(sample.value):
                done.set_result(True)
            elif sample.t - began > timeout:
                done.set_result(False)

        undo = self.states.subscribe(look)
        try:
            await self._life.wait_for(done)
        finally:
            undo()
        return done.result()

    # -- inside

    async def _poll(self) -> None:
        while self._life.good:
            await self._clock.sleep(self._polled.poll_period_s)
            try:
                await self._look()
                self._failures_in_a_row = 0
            except NoAnswer as exc:
                self._failures += 1
                self._failures_in_a_row += 1
                if self._failures_in_a_row >= self._polled.lost_after_failures:
                    self._life.lose(error("DEVICE_LOST", f"{self.name}: {exc}"))
            except CellError as exc:
                self._life.lose(exc)

    async def _look(self) -> None:
        begin = self._clock.now()
        state = await self._ask()
        end = self._clock.now()
        self._seq += 1
        self.states.push(Sample(state, 0.5 * (begin + end), 0.5 * (end - begin), self._seq))
