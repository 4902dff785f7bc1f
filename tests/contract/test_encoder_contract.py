"""The contract of a belt encoder on the object face, on a serial CAN adapter and on a CAN gateway."""

import pytest
from encoder_faces import encoder_faces
from wire_faces import Face

from cell.testing import Bench, EncoderContract, EncoderRig


class TestEncoder(EncoderContract):
    @pytest.fixture(params=encoder_faces())
    def subject(self, request: pytest.FixtureRequest) -> Bench[EncoderRig]:
        face: Face[EncoderRig] = request.param
        return face.bench()
