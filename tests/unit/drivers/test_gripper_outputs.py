"""Which outputs of the arm close and open a gripper, and what is said of a configuration that cannot work."""

import pytest
from pydantic import ValidationError

from drivers.ur.gripper import ArmGripper
from drivers.ur.gripper_outputs import GripperOutputs


def test_two_outputs_of_two_banks_are_written_together_and_their_masks_let_go() -> None:
    subject = GripperOutputs(closes=2, opens=9, inverted=False)
    assert subject.variables == (
        *("standard_digital_output_mask", "standard_digital_output"),
        *("configurable_digital_output_mask", "configurable_digital_output"),
    )
    wrote, let_go = subject.packages(subject.levels(close=False, opening=True))
    assert wrote == {
        "standard_digital_output_mask": 0b100,
        "standard_digital_output": 0,
        "configurable_digital_output_mask": 0b10,
        "configurable_digital_output": 0b10,
    }
    assert {name: value for name, value in let_go.items() if value} == {"configurable_digital_output": 0b10}
    assert subject.are(1 << 9, [(2, False), (9, True)])
    assert not subject.are(1 << 2, [(2, False)])


def test_an_inverted_output_closes_when_it_is_off() -> None:
    subject = GripperOutputs(closes=16, opens=None, inverted=True)
    assert subject.levels(close=True, opening=False) == [(16, False)]
    assert subject.is_closed(0)
    assert not subject.is_closed(1 << 16)


@pytest.mark.parametrize(
    ("keys", "told"),
    [
        ({"output": 0}, "it is unknown when it has closed"),
        ({"output": 0, "moves_s": 0.3, "open_output": 0}, "open_output is 0, which is output"),
        ({"output": 0, "confirm": 7, "blow_off_s": 0.1}, "blow_off_s is of an open_output"),
    ],
)
def test_a_gripper_that_cannot_work_is_told_why(keys: dict[str, float], told: str) -> None:
    with pytest.raises(ValidationError, match=told):
        ArmGripper.Config.model_validate(keys)
