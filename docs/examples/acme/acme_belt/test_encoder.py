"""The encoder keeps the contract of encoders: ``pytest --pyargs acme_belt``."""

import pytest

from acme_belt.encoder import AcmeEncoder
from cell.testing import Bench, EncoderContract, EncoderRig, bench


class TestAcmeEncoder(EncoderContract):
    @pytest.fixture
    def subject(self) -> Bench[EncoderRig]:
        return bench(EncoderRig, AcmeEncoder, counts_per_s=20_000.0)  # it wraps after three seconds
