"""The faces on which the contract suite runs: what makes an arm or a camera, and what breaks it.

The suite (``test_arm_contract.py``, ``test_camera_contract.py``) knows nothing but a :class:`Rig`. The object
face is here. Another face is added with :func:`add_arm_face` or :func:`add_camera_face` at the end of this
file: a name, a function that runs a coroutine (``asyncio.run`` on the wire), and an asynchronous context
manager that yields a :class:`Rig` with the device open and everything taken down afterwards. A face on real
sockets or children gets ``wire=True``, which marks its tests. ``lacks`` names the faults it cannot show.
"""

from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import pytest

from cell.clock import Clock
from cell.devices import Arm, DepthCamera
from fakes.object import ObjectArm, ObjectCamera, VirtualClock, run_virtual
from fakes.world import World

D = TypeVar("D")


@dataclass
class Rig(Generic[D]):
    """One open device of the ``hand_eye`` scenario with its world.

    ``inject(kind, **arguments)`` begins a fault of the common vocabulary, ``inject("clear")`` puts all right.
    """

    device: D
    clock: Clock
    world: World
    inject: Callable[..., Awaitable[None]]


@dataclass(frozen=True)
class Face(Generic[D]):
    """How one face runs and makes its rig."""

    name: str
    run: Callable[[Coroutine[Any, Any, Any]], Any]
    rig: Callable[[], AbstractAsyncContextManager[Rig[D]]]
    wire: bool = False
    lacks: frozenset[str] = frozenset()


_arm_faces: list[Face[Arm]] = []
_camera_faces: list[Face[DepthCamera]] = []


def add_arm_face(face: Face[Arm]) -> None:
    """Run the arm's contract on this face too."""
    _arm_faces.append(face)


def add_camera_face(face: Face[DepthCamera]) -> None:
    """Run the camera's contract on this face too."""
    _camera_faces.append(face)


def arm_faces() -> list[Any]:
    """Parameters for a fixture."""
    return [_parameter(face) for face in _arm_faces]


def camera_faces() -> list[Any]:
    """Parameters for a fixture."""
    return [_parameter(face) for face in _camera_faces]


def _parameter(face: Face[Any]) -> Any:
    return pytest.param(face, id=face.name, marks=[pytest.mark.wire] if face.wire else [])


# -- the object face

SCENARIO = "hand_eye"


@asynccontextmanager
async def _object_arm() -> AsyncIterator[Rig[Arm]]:
    clock = VirtualClock()
    arm = ObjectArm("arm", ObjectArm.Config(scenario=SCENARIO), clock)

    async def inject(kind: str, **arguments: Any) -> None:
        arm.inject(kind, **arguments)

    await arm.open()
    try:
        yield Rig(arm, clock, arm.world, inject)
    finally:
        await arm.close()


@asynccontextmanager
async def _object_camera() -> AsyncIterator[Rig[DepthCamera]]:
    clock = VirtualClock()
    camera = ObjectCamera("camera", ObjectCamera.Config(scenario=SCENARIO), clock)

    async def inject(kind: str, **arguments: Any) -> None:
        camera.inject(kind, **arguments)

    await camera.open()
    try:
        yield Rig(camera, clock, camera.world, inject)
    finally:
        await camera.close()


add_arm_face(Face("object", run_virtual, _object_arm))
add_camera_face(Face("object", run_virtual, _object_camera))
