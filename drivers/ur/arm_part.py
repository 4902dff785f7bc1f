"""A device that is a part of an arm which another section of the config names."""

import asyncio
from typing import Any, ClassVar

from cell.clock import Clock
from cell.devices import Arm, Device
from cell.errors import error
from drivers.life import LinkedDevice


class ArmPart(LinkedDevice):
    """It is up while the arm gives states, and lost when the arm is."""

    BINDS: ClassVar[dict[str, type]] = {"arm": Arm}

    def __init__(self, name: str, clock: Clock) -> None:
        super().__init__(name, clock)
        self._arm: Any = None
        self._watch: asyncio.Task[None] | None = None

    def bind(self, arm: Device) -> None:
        """The arm that the config names."""
        self._arm = arm

    async def wait_fresh(self, timeout: float) -> None:
        """Return when the arm has sent a state after the call, else ``DEVICE_LOST``.

        The arm judges, as it knows its ``time_offset_s``, which is in what its parts read of it too.
        """
        self._life.require()
        await self._arm.wait_fresh(timeout)
        self._life.require()

    def _watch_arm(self) -> None:
        self._watch = asyncio.create_task(self._until_arm_lost(), name=f"{self.name} watch")

    async def _stop_watching(self) -> None:
        watch, self._watch = self._watch, None
        if watch is not None:
            watch.cancel()
            await asyncio.wait([watch])

    async def _until_arm_lost(self) -> None:
        cause = await self._arm.wait_lost()
        self._life.lose(error("DEVICE_LOST", f"{self.name}: {self._arm.name} is lost: {cause}"))
