"""A controller on the wire and an arm connected to it, for the tests of the arm driver."""

import asyncio
import os
import random
import socket
import time
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager, suppress
from dataclasses import dataclass
from typing import Any

from cell.clock import MonotonicClock
from cell.devices import ToolSettings
from cell.poses import from_pose6
from drivers.ur import UrArm
from drivers.ur.motion import UrMotion
from fakes.ur.process import ControllerHandle, running_controller

TOOL = ToolSettings(from_pose6([0.0, 0.0, 0.18, 0.0, 0.0, 0.0]), 1.2)

# A controller that showed one of these is not used for another test.
LASTING = {"kill", "reboot", "clock-jump"}


# A machine that runs other tests as well is no controller PC; tests of the limits give their own.
PATIENT = {"stale_after_s": 0.1, "silent_after_s": 0.3, "lost_after_s": 0.3, "watchdog_min_hz": 5.0}


# The client's ports are fixed, so controllers differ by address, and tests that run side by side have theirs
# apart. 127.0.0.38 and .39 have other uses.
_WORKER, _WORKERS = (
    int(os.environ.get(f"PYTEST_XDIST_WORKER{name}", alone).removeprefix("gw"))
    for name, alone in (("", "0"), ("_COUNT", "1"))
)
ADDRESSES = [f"127.0.0.{k}" for k in range(20, 38)][_WORKER::_WORKERS]


def _free_address() -> str:
    for host in random.sample(ADDRESSES, len(ADDRESSES)):
        with socket.socket() as probe, suppress(OSError):
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind((host, 30004))
            return host
    raise AssertionError("every address of these tests is in use")


@contextmanager
def _ahead_of_other_work() -> Iterator[None]:
    """Where the user may, run the real-time parts at a higher priority, which children inherit."""
    before = os.getpriority(os.PRIO_PROCESS, 0)
    with suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, 0, -10)
    try:
        yield
    finally:
        with suppress(PermissionError):
            os.setpriority(os.PRIO_PROCESS, 0, before)


@dataclass
class Rig:
    """A running controller and its address."""

    host: str
    controller: ControllerHandle

    @classmethod
    @contextmanager
    def running(cls, **settings: Any) -> Iterator["Rig"]:
        """A controller on an address that no other run of these tests uses."""
        host = _free_address()
        with _ahead_of_other_work(), running_controller(host, **settings) as handle:
            yield cls(host, handle)

    def inject(self, fault: str, **arguments: Any) -> None:
        self.controller.inject(fault, **arguments)

    def truth(self) -> dict[str, Any]:
        return self.controller.truth()

    @asynccontextmanager
    async def connected(self, **config: Any) -> AsyncIterator[UrArm]:
        arm = UrArm("arm", UrArm.Config(host=self.host, **(PATIENT | config)), MonotonicClock())
        await arm.open()
        try:
            yield arm
        finally:
            await arm.close()

    @asynccontextmanager
    async def movable(self) -> AsyncIterator[tuple[UrArm, UrMotion]]:
        async with self.connected() as arm:
            port = await arm.open_motion(TOOL)
            try:
                yield arm, port
            finally:
                await port.close()

    def tidy(self) -> None:
        """End faults and programs, so that the next test finds the controller as it was."""
        self.inject("clear")
        deadline = time.monotonic() + 5.0
        while time.monotonic() < deadline:
            try:
                with socket.create_connection((self.host, 29999), 1.0) as dashboard:
                    dashboard.sendall(b"stop\n")
                    dashboard.recv(200)
                if self.truth()["program"] is None and not self.truth()["moving"]:
                    return
            except OSError:
                pass
            time.sleep(0.02)
        raise AssertionError(f"the controller did not come to rest: {self.truth()}")


async def until(holds: Callable[[], bool], timeout: float = 5.0) -> None:
    """Wait for a condition; the assertion fails after ``timeout``."""
    deadline = time.monotonic() + timeout
    for _ in range(int(timeout / 0.005)):
        if holds() or time.monotonic() > deadline:
            break
        await asyncio.sleep(0.005)
    assert holds()
