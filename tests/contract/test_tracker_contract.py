"""The contract of a tracker on the object face, over GeoCOM on TCP and on a serial line."""

import pytest
from tracker_faces import tracker_faces
from wire_faces import Face

from cell.testing import Bench, TrackerContract, TrackerRig


class TestTracker(TrackerContract):
    @pytest.fixture(params=tracker_faces())
    def subject(self, request: pytest.FixtureRequest) -> Bench[TrackerRig]:
        face: Face[TrackerRig] = request.param
        return face.bench()
