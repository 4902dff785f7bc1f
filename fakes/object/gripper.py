"""The gripper of the object face: the world's fingers, without the arm's outputs in between."""

import asyncio
from typing import Any

from pydantic import Field

from cell.clock import Clock
from cell.devices import Gripper, Identity
from cell.errors import error
from cell.formats.reading import Strict
from fakes.object._lazy import LazyStream
from fakes.object._plant import ObjectDevice
from fakes.object.registry import cell_of

_LOOK_S = 0.008


class ObjectGripperConfig(Strict):
    """Keys of a device with ``driver = "fakes.object:ObjectGripper"``."""

    scenario: str = Field(description="scenario file, or the name of a shipped one")
    counts_after_s: float | None = Field(
        default=None,
        ge=0,
        le=5,
        description="nothing confirms: it counts as closed, or open, after so long, whether it holds or not",
    )
    lost_after_s: float = Field(default=0.1, gt=0, le=5)


class ObjectGripper(ObjectDevice):
    """``cell.devices.Gripper`` on virtual time. It is lost with the arm that it hangs on."""

    Config = ObjectGripperConfig
    PLAYS = (Gripper,)

    def __init__(self, name: str, config: ObjectGripperConfig, clock: Clock) -> None:
        self._cell = cell_of(config.scenario, clock)
        super().__init__(name, clock, self._cell.controller, config.lost_after_s)
        self.config = config
        gripper = self._cell.world.gripper
        if gripper is None:
            raise error("CONFIG_INVALID", "the scenario has no [world.gripper]")
        self.gripper = gripper
        self.held: LazyStream[bool] = LazyStream(
            f"{name}.held", clock, _LOOK_S, lambda t, _: gripper.holds(t) is not None, dt=0.0
        )
        self.stream = self.held

    @property
    def confirms(self) -> bool:
        """Whether anything tells that something is held."""
        return self.config.counts_after_s is None

    async def open(self) -> None:
        """Connect; ``DEVICE_UNREACHABLE`` while the arm refuses."""
        await super().open()
        self._cell.start()

    async def identify(self) -> Identity:
        """That of the arm."""
        self._check()
        return Identity("object-gripper", self.plant.serial)

    async def grip(self, timeout: float) -> bool:
        """Close; True when something is held within ``timeout`` s."""
        return await self._command(True, timeout)

    async def release(self, timeout: float) -> bool:
        """Open; True when nothing is held within ``timeout`` s."""
        return await self._command(False, timeout)

    def holding(self, max_age: float) -> bool:
        """Whether something is held, or it is told to close where nothing confirms; ``STALE_DATA`` when the
        link is silent."""
        self._check()
        held = self.held.latest(max_age).value
        return held if self.config.counts_after_s is None else self.gripper.closed

    async def _command(self, close: bool, timeout: float) -> bool:
        self._check()
        self.held.fill()
        self.gripper.command(self.clock.now(), close)
        if self.config.counts_after_s is not None:
            return await self._counts(self.config.counts_after_s, timeout)
        seen = asyncio.Event()

        def look(sample: Any) -> None:
            if sample.value is close:
                seen.set()

        undo = self.held.subscribe(look)
        try:
            async with asyncio.timeout(timeout):
                await seen.wait()
        except TimeoutError:
            return False
        finally:
            undo()
        self._check()
        return True

    async def _counts(self, after_s: float, timeout: float) -> bool:
        """As the drivers do without an input that confirms."""
        if after_s > timeout:
            text = f"{self.name}: moves_s is {after_s:g} s, and the timeout is {timeout:g} s"
            raise error("ARGUMENT_INVALID", text)
        await self.clock.sleep(after_s)
        self._check()
        return True

    def _check(self) -> None:
        if self.lost is not None:
            raise error(self.lost.name, self.lost.detail)
