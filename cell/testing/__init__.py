"""Contract suites: what every driver of a kind must do, as pytest classes that any package can run.

Needs pytest (``pip install cellward[testing]``). A suite is a class to inherit from; its fixture ``subject``
is a :class:`~cell.testing.bench.Bench`, which opens the driver for each case::

    from cell.testing import EncoderContract, EncoderRig, bench

    class TestAcmeEncoder(EncoderContract):
        @pytest.fixture
        def subject(self) -> Bench[EncoderRig]:
            return bench(EncoderRig, AcmeEncoder, counts_per_s=500.0)
"""

import pytest

_SUITES = ("arm", "camera", "encoder", "gripper", "inputs", "observed_arm", "taken_again", "tracker")
pytest.register_assert_rewrite(*(f"cell.testing.{name}" for name in _SUITES))

from cell.testing.arm import ArmContract, ArmRig  # noqa: E402  (rewritten only if imported afterwards)
from cell.testing.bench import Bench, Rig, bench  # noqa: E402
from cell.testing.camera import CameraContract, CameraRig  # noqa: E402
from cell.testing.encoder import EncoderContract, EncoderRig  # noqa: E402
from cell.testing.gripper import GripperContract, GripperRig  # noqa: E402
from cell.testing.inputs import InputsContract, InputsRig  # noqa: E402
from cell.testing.observed_arm import ObservedArmContract, ObservedArmRig  # noqa: E402
from cell.testing.tracker import TrackerContract, TrackerRig  # noqa: E402

__all__ = [
    "ArmContract",
    "ArmRig",
    "Bench",
    "CameraContract",
    "CameraRig",
    "EncoderContract",
    "EncoderRig",
    "GripperContract",
    "GripperRig",
    "InputsContract",
    "InputsRig",
    "ObservedArmContract",
    "ObservedArmRig",
    "Rig",
    "TrackerContract",
    "TrackerRig",
    "bench",
]
