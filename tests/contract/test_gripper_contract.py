"""The contract of a gripper: on the object face, and on the wire a Modbus module and a Robotiq."""

import pytest
from gripper_faces import gripper_faces

from cell.testing import Bench, GripperContract, GripperRig


class TestGripper(GripperContract):
    @pytest.fixture(params=gripper_faces())
    def subject(self, request: pytest.FixtureRequest) -> Bench[GripperRig]:
        found: Bench[GripperRig] = request.param
        return found
