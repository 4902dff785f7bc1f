"""The camera of a twin: its process, and somebody who starts it again when it died."""

import asyncio
from pathlib import Path
from typing import Any

from cell.errors import error
from fakes.frames.faults import CameraFaults
from fakes.twin.mirror import FrameProcess
from fakes.world.world import World

START_TIMEOUT_S = 20.0
RESTART_S = 2.0


class TwinCamera:
    """Serves frames on ``socket`` between :meth:`start` and :meth:`stop`."""

    def __init__(self, socket: Path, scenario: str, world: World) -> None:
        self.socket = socket
        self._scenario, self._world = scenario, world
        self._process = self._new_process()
        self._restart: asyncio.TimerHandle | None = None
        self.faults = CameraFaults(lambda message: self._process.send(message))

    def fork(self) -> None:
        """Make the process beforehand, as a copy of a program that begins."""
        self._process.fork()

    async def start(self) -> None:
        """Start the process and wait until it listens."""
        self._begin()
        loop = asyncio.get_running_loop()
        give_up = loop.time() + START_TIMEOUT_S
        while not self.socket.exists():
            if not self._process.alive:
                raise error("CHILD_DIED", "the frame server ended while it started")
            if loop.time() > give_up:
                raise error("CALL_TIMEOUT", f"the frame server did not listen in {START_TIMEOUT_S:g} s")
            await asyncio.sleep(0.02)

    async def stop(self) -> None:
        """End the process."""
        if self._restart is not None:
            self._restart.cancel()
        if self._process.alive:
            asyncio.get_running_loop().remove_reader(self._process.sentinel)
        await asyncio.to_thread(self._process.stop)

    def addresses(self) -> dict[str, str]:
        """What listens where, by name."""
        return {"camera frames": f"frames+unix://{self.socket}"}

    def device(self) -> dict[str, Any]:
        """The table ``[device.camera]`` of a daemon's configuration.

        Pictures are drawn on the cores that also look at them: ten may be missed.
        """
        timeout = max(2.5, 10.0 * self._world.camera.period_s)
        section = {"driver": "oak", "source": self.addresses()["camera frames"], "frame_timeout_s": timeout}
        return section if self._world.camera.depth else {**section, "depth": False}

    def _new_process(self) -> FrameProcess:
        return FrameProcess(str(self.socket), self._scenario, self._world)

    def _begin(self) -> None:
        self.socket.unlink(missing_ok=True)
        self._process.start()
        asyncio.get_running_loop().add_reader(self._process.sentinel, self._ended)

    def _ended(self) -> None:
        loop = asyncio.get_running_loop()
        loop.remove_reader(self._process.sentinel)
        self._process.stop()
        self._process = self._new_process()
        self._restart = loop.call_later(RESTART_S, self._begin)
