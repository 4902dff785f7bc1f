"""The contract of digital inputs on the object face, over Modbus TCP and on a serial line."""

import pytest
from inputs_faces import inputs_faces
from wire_faces import Face

from cell.testing import Bench, InputsContract, InputsRig


class TestInputs(InputsContract):
    @pytest.fixture(params=inputs_faces())
    def subject(self, request: pytest.FixtureRequest) -> Bench[InputsRig]:
        face: Face[InputsRig] = request.param
        return face.bench()
