"""The contract of a camera on the object face and on the wire."""

from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from typing import Any

import pytest
from wire_faces import Face, camera_faces

from cell.testing import Bench, CameraContract, CameraRig


@pytest.fixture(scope="module", params=camera_faces())
def face(request: pytest.FixtureRequest) -> Face[CameraRig]:
    return request.param


@pytest.fixture(scope="module")
def server(face: Face[CameraRig]) -> Iterator[Any]:
    with face.serve() as served:
        yield served


class TestCamera(CameraContract):
    @pytest.fixture
    def subject(self, face: Face[CameraRig], server: Any) -> Bench[CameraRig]:
        """Its scenes begin with a camera that looks for the scenario's board."""

        @asynccontextmanager
        async def looking() -> AsyncIterator[CameraRig]:
            async with face.rig(server) as rig:
                await rig.device.set_target(rig.seen.target)
                yield rig

        return Bench(looking, face.run, face.lacks)
