"""The faces on which the contract suite runs: what makes an arm or a camera, and what breaks it.

The suite (``cell.testing``) knows nothing but an :class:`ArmRig` or a :class:`CameraRig`.
Another face is added with :func:`add_arm_face` or :func:`add_camera_face` at the end of
this file; see :class:`Face` for what it consists of. A face on real sockets or children gets ``wire=True``,
which marks its tests. ``lacks`` names the faults that it cannot show.
"""

import asyncio
import tempfile
import time
from collections.abc import AsyncIterator, Callable, Coroutine, Iterator
from contextlib import (
    AbstractAsyncContextManager,
    AbstractContextManager,
    asynccontextmanager,
    contextmanager,
    nullcontext,
)
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np
import pytest

from cell.clock import MonotonicClock
from cell.devices import Identity
from cell.poses import Array
from cell.testing import ArmRig, Bench, CameraRig, Rig
from drivers.oak import OakCamera
from drivers.ur import UrArm
from fakes.faults.vocabulary import Switchboard
from fakes.frames.faults import CameraFaults
from fakes.object import ObjectArm, ObjectCamera, VirtualClock, run_virtual
from fakes.twin.mirror import FrameProcess
from fakes.ur.process import ControllerHandle, running_controller
from fakes.world.scenario import Scenario
from fakes.world.world import World

R = TypeVar("R", bound=Rig[Any])


@dataclass(frozen=True)
class Face(Generic[R]):
    """One face of a device.

    ``serve`` makes what is expensive, such as a server process, once for a module. ``rig`` is given what
    ``serve`` gave; it yields a rig with the device open and leaves the server as it was. ``run`` runs a
    coroutine to its end.
    """

    name: str
    run: Callable[[Coroutine[Any, Any, Any]], Any]
    rig: Callable[[Any], AbstractAsyncContextManager[R]]
    serve: Callable[[], AbstractContextManager[Any]] = nullcontext
    wire: bool = False
    lacks: frozenset[str] = frozenset()

    def bench(self, served: Any = None, retried: bool = False) -> Bench[R]:
        """What a suite plays its scenes on."""
        return Bench(lambda: self.rig(served), self.run, self.lacks, retried)


_arm_faces: list[Face[ArmRig]] = []
_camera_faces: list[Face[CameraRig]] = []


def add_arm_face(face: Face[ArmRig]) -> None:
    """Run the arm's contract on this face too."""
    _arm_faces.append(face)


def add_camera_face(face: Face[CameraRig]) -> None:
    """Run the camera's contract on this face too."""
    _camera_faces.append(face)


def arm_faces() -> list[Any]:
    """Parameters for a fixture."""
    return [_parameter(face) for face in _arm_faces]


def camera_faces() -> list[Any]:
    """Parameters for a fixture."""
    return [_parameter(face) for face in _camera_faces]


def _parameter(face: Face[Any]) -> Any:
    marks = [pytest.mark.wire] * face.wire
    return pytest.param(face, id=face.name, marks=marks)


# -- the object face

SCENARIO = "hand_eye:ideal"
HOME = np.array([0.0, -1.8, 1.8, -1.57, -1.57, 0.0])
AWAY = HOME + np.array([0.5, -0.2, 0.3, 0.2, -0.4, 0.6])
OF_THE_ARM: dict[str, Any] = {"identity": Identity("ur10e", "99991100001"), "home": HOME, "away": AWAY}


def _camera_of(world: World) -> Identity:
    return Identity("", world.config.camera.serial)


@asynccontextmanager
async def _object_arm(_: None) -> AsyncIterator[ArmRig]:
    clock = VirtualClock()
    arm = ObjectArm("arm", ObjectArm.Config(scenario=SCENARIO), clock)

    async def inject(kind: str, **arguments: Any) -> None:
        arm.inject(kind, **arguments)

    async def truth() -> tuple[Array, bool]:
        q, qd = arm.world.track.at(clock.now())
        return q, bool(np.any(qd))

    await arm.open()
    try:
        yield ArmRig(arm, clock, inject=inject, truth=truth, **OF_THE_ARM)
    finally:
        await arm.close()


@asynccontextmanager
async def _object_camera(_: None) -> AsyncIterator[CameraRig]:
    clock = VirtualClock()
    camera = ObjectCamera("camera", ObjectCamera.Config(scenario=SCENARIO), clock)

    async def inject(kind: str, **arguments: Any) -> None:
        camera.inject(kind, **arguments)

    await camera.open()
    try:
        yield CameraRig(camera, clock, inject=inject, identity=_camera_of(camera.world), world=camera.world)
    finally:
        await camera.close()


add_arm_face(Face("object", run_virtual, _object_arm))
add_camera_face(Face("object", run_virtual, _object_camera))


# -- the arm on the wire: the driver for UR, and a controller in a process of its own

ARM_HOST = "127.0.73.11"
# Longer than in production, because the machine under the tests may pause.
PATIENT = {"stale_after_s": 1.0, "silent_after_s": 1.0, "lost_after_s": 1.5, "watchdog_min_hz": 5.0}


@asynccontextmanager
async def _wire_arm(controller: ControllerHandle) -> AsyncIterator[ArmRig]:
    clock = MonotonicClock()
    arm = UrArm("arm", UrArm.Config(host=ARM_HOST, **PATIENT), clock)

    async def inject(kind: str, **arguments: Any) -> None:
        await asyncio.to_thread(lambda: controller.inject(kind, **arguments))

    async def truth() -> tuple[Array, bool]:
        state = await asyncio.to_thread(controller.truth)
        return np.array(state["q"]), bool(state["moving"])

    await arm.open()
    try:
        yield ArmRig(arm, clock, inject=inject, truth=truth, **OF_THE_ARM)
    finally:
        await arm.close()
        await inject("clear")
        await _until_idle(controller)


async def _until_idle(controller: ControllerHandle) -> None:
    """The next test finds the controller as this one did."""
    for _ in range(200):
        state = await asyncio.to_thread(controller.truth)
        if not state["moving"] and state["program"] is None:
            return
        await asyncio.sleep(0.02)
    raise AssertionError(f"the controller does not come to rest: {state}")


_controller = partial(running_controller, ARM_HOST, SCENARIO)
add_arm_face(Face("wire", asyncio.run, _wire_arm, _controller, wire=True))


# -- the camera on the wire: the driver for OAK with its vision child, and a frame server's process

FRAMES_START_S = 120.0


@dataclass(frozen=True)
class FrameServing:
    """A frame server's process on ``socket``, which follows ``world`` and takes faults."""

    socket: Path
    world: World
    faults: Switchboard


@contextmanager
def _frame_serving() -> Iterator[FrameServing]:
    world = World.from_scenario(Scenario.load(SCENARIO), time.monotonic())
    faults = Switchboard()
    with tempfile.TemporaryDirectory(prefix="frames-") as folder:
        socket = Path(folder) / "frames.sock"
        process = FrameProcess(str(socket), SCENARIO, world)
        faults.devices["camera"] = CameraFaults(process.send)
        process.start()
        try:
            _until_it_listens(process, socket)
            yield FrameServing(socket, world, faults)
        finally:
            process.stop()


def _until_it_listens(process: FrameProcess, socket: Path) -> None:
    deadline = time.monotonic() + FRAMES_START_S
    while not socket.exists():
        assert process.alive, "the frame server ended while it started"
        assert time.monotonic() < deadline, f"no frame server within {FRAMES_START_S:.0f} s"
        time.sleep(0.02)


@asynccontextmanager
async def _wire_camera(served: FrameServing) -> AsyncIterator[CameraRig]:
    clock = MonotonicClock()
    config = OakCamera.Config(source=f"frames+unix://{served.socket}", frame_timeout_s=4.0)
    camera = OakCamera("camera", config, clock)

    async def inject(kind: str, **arguments: Any) -> None:
        served.faults.inject("camera", kind, arguments)

    try:
        await camera.open()
        yield CameraRig(camera, clock, inject=inject, identity=_camera_of(served.world), world=served.world)
    finally:
        await camera.close()
        await inject("clear")
        # The next test finds the board where this one did.
        served.world.operator.confirm(0, clock.now())


add_camera_face(Face("wire", asyncio.run, _wire_camera, _frame_serving, wire=True, lacks=frozenset({"gap"})))
