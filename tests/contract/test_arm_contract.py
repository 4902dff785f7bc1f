"""The contract of an arm on the object face and on the wire."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from wire_faces import Face, arm_faces

from cell.testing import ArmContract, ArmRig, Bench
from tests.kit.ur_reference import independent_library


@pytest.fixture(scope="module", params=arm_faces())
def face(request: pytest.FixtureRequest) -> Face[ArmRig]:
    return request.param


@pytest.fixture(scope="module")
def server(face: Face[ArmRig]) -> Iterator[Any]:
    with face.serve() as served:
        yield served


class TestArm(ArmContract):
    @pytest.fixture
    def subject(self, face: Face[ArmRig], server: Any) -> Bench[ArmRig]:
        return face.bench(server, retried=True)

    def test_the_flange_pose_is_that_of_the_published_kinematics(self, subject: Bench[ArmRig]) -> None:
        library = independent_library()

        async def scene(rig: ArmRig) -> None:
            await rig.device.wait_fresh(3.0)
            seen = rig.device.state.latest(0.5).value
            reference = library.ur10e.forward_kinematics(*seen.q)
            assert np.allclose(seen.T_base_flange.as_matrix(), reference, atol=1e-6)

        subject(scene)
