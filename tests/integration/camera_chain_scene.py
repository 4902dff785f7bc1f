"""A frame server in a process of its own, and cameras that look at its world."""

import asyncio
import multiprocessing
import time
from collections.abc import Awaitable, Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from cell.clock import MonotonicClock
from cell.errors import CellError
from cell.testing import taken_again
from drivers.oak import OakCamera
from fakes.frames.faults import CameraFaults
from fakes.frames.server import serve_frames
from fakes.world.scenario import Scenario
from fakes.world.world import Message, World


class Twin:
    """The frame server's process and the world that it mirrors."""

    def __init__(self, folder: Path, scenario: str = "hand_eye:ideal") -> None:
        self.path = folder / "frames.sock"
        self.world = World.from_scenario(Scenario.load(scenario), time.monotonic())
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        arguments = (str(self.path), scenario, theirs)
        self.process = context.Process(target=serve_frames, args=arguments, daemon=True)
        self.process.start()
        theirs.close()
        self.world.mirror_to(self._send)
        self.faults = CameraFaults(self._send)

    def _send(self, message: Message) -> None:
        self._pipe.send([message])  # several may go together

    def wait(self) -> None:
        deadline = time.monotonic() + 120.0
        while not self.path.exists():
            assert self.process.is_alive()
            assert time.monotonic() < deadline
            time.sleep(0.05)

    def close(self) -> None:
        self._pipe.close()
        self.process.join(5.0)
        assert not self.process.is_alive(), "the server ends with its pipe"


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Twin]:
    twin = Twin(tmp_path_factory.mktemp("twin"))
    twin.wait()
    yield twin
    twin.close()


@pytest.fixture
def twin(server: Twin) -> Iterator[Twin]:
    yield server
    server.faults.clear()


class OpenCamera:
    """A camera that is open, with its target chosen, and a loop for it: its child takes seconds to start."""

    def __init__(self, twin: Twin) -> None:
        self._runner = asyncio.Runner()
        # More than the usual patience: the machine that runs the tests may pause.
        self.camera = camera(twin, frame_timeout_s=8.0)

    def run(self, test: Callable[[], Awaitable[None]]) -> None:
        async def body() -> None:
            try:
                await self.camera.wait_fresh(10.0)
            except CellError:  # not open yet, or lost by what a test did to the server
                await open_with_target(self.camera)
            async with asyncio.timeout(60.0):
                await test()

        taken_again.play(body, self._runner.run)

    def close(self) -> None:
        self._runner.run(self.camera.close())
        self._runner.close()


@pytest.fixture(scope="module")
def shared(server: Twin) -> Iterator[OpenCamera]:
    """For tests that leave the camera as it was."""
    opened_once = OpenCamera(server)
    opened_once.run(opened_once.camera.identify)  # its child is not one of the first test's
    yield opened_once
    opened_once.close()


@pytest.fixture
def subject(shared: OpenCamera, twin: Twin) -> OakCamera:
    return shared.camera


@pytest.fixture
def own(twin: Twin) -> OakCamera:
    """For a test that spoils it."""
    return camera(twin, frame_timeout_s=8.0)


@pytest.fixture
def hasty(twin: Twin) -> OakCamera:
    """For losses by silence."""
    return camera(twin, frame_timeout_s=2.0)


def camera(twin: Twin, **config: Any) -> OakCamera:
    source = f"frames+unix://{twin.path}"
    return OakCamera("camera", OakCamera.Config(source=source, **config), MonotonicClock())


async def open_with_target(camera: OakCamera) -> None:
    await camera.close()
    await camera.set_target(Scenario.load("hand_eye:ideal").world.target)
    await camera.open()


def opened(subject: OakCamera, test: Callable[[], Awaitable[None]]) -> None:
    """Run ``test`` with the camera open and its target chosen; again where a pause interrupted it."""

    async def body() -> None:
        await open_with_target(subject)
        try:
            async with asyncio.timeout(60.0):
                await test()
        finally:
            await subject.close()

    taken_again.play(body)
