"""A controller on the wire and an arm connected to it, for the tests of the arm driver."""

import asyncio
import os
import random
import socket
import time
from collections.abc import AsyncIterator, Callable, Coroutine, Iterator
from contextlib import asynccontextmanager, contextmanager, suppress
from dataclasses import dataclass
from typing import Any

from cell.clock import MonotonicClock
from cell.devices import ToolSettings
from cell.errors import error
from cell.poses import from_pose6
from cell.standstill import measured_standstill
from cell.testing.taken_again import play
from drivers.ur import UrArm
from drivers.ur.motion import UrMotion
from fakes.ur.process import ControllerHandle, running_controller

TOOL = ToolSettings(from_pose6([0.0, 0.0, 0.18, 0.0, 0.0, 0.0]), 1.2)

# A controller that showed one of these is not used for another test.
LASTING = {"kill", "reboot", "clock-jump"}


# A machine that runs other tests as well is no controller PC; tests of the limits give their own.
PATIENT = {"stale_after_s": 1.0, "silent_after_s": 1.0, "lost_after_s": 2.0, "watchdog_min_hz": 5.0}
PAUSE_S = 0.03


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

    def play(self, scenario: Callable[[], Coroutine[Any, Any, None]]) -> None:
        """Run it, and again where a pause of this machine interrupted it."""
        play(scenario, tidy=self.tidy)

    @asynccontextmanager
    async def connected(self, **config: Any) -> AsyncIterator[UrArm]:
        arm = UrArm("arm", UrArm.Config(host=self.host, **(PATIENT | config)), MonotonicClock())
        await arm.open()
        try:
            yield arm
        finally:
            await _end_started()
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


_started: set[asyncio.Task[Any]] = set()


async def start(arm: UrArm, move: Coroutine[Any, Any, Any]) -> "asyncio.Task[Any]":
    """The move well under way: samples show it. What ended it before that is raised."""
    task = asyncio.create_task(move)
    _started.add(task)
    await until(lambda: task.done() or not arm.state.latest(PATIENT["lost_after_s"]).value.at_rest)
    await asyncio.wait([task], timeout=0.15)
    if task.done():
        await task
        raise AssertionError("the move ended before anything happened to it")
    return task


async def _end_started() -> None:
    for task in _started:
        task.cancel()
    await asyncio.gather(*_started, return_exceptions=True)
    _started.clear()


@asynccontextmanager
async def own_pauses() -> AsyncIterator[list[float]]:
    """How long this process was late each time, s: a limit in time is one of the time that it had."""
    pauses: list[float] = []

    async def watch() -> None:
        due = time.monotonic()
        while True:
            due += 0.005
            await asyncio.sleep(due - time.monotonic())
            now = time.monotonic()
            if now - due > PAUSE_S:
                pauses.append(now - due)
            due = now

    watching = asyncio.create_task(watch())
    try:
        yield pauses
    finally:
        await asyncio.sleep(0.0)  # a pause that has just ended is noted
        watching.cancel()
        await asyncio.wait([watching])


def untouched(pauses: list[float]) -> None:
    """What was measured while this process stood still is not used: the scene is played again."""
    if pauses:
        raise error("STALE_DATA", f"this process stood still for {pauses} s")


async def rests(arm: UrArm, within_s: float) -> None:
    """The samples show rest, after at most so much time that this process had."""
    began = time.monotonic()
    async with own_pauses() as pauses:
        assert await measured_standstill(arm, 10.0)
    assert time.monotonic() - began - sum(pauses) < within_s


async def until(holds: Callable[[], bool], timeout: float = 5.0) -> None:
    """Wait for a condition; the assertion fails after ``timeout``."""
    deadline = time.monotonic() + timeout
    for _ in range(int(timeout / 0.005)):
        if holds() or time.monotonic() > deadline:
            break
        await asyncio.sleep(0.005)
    assert holds()
