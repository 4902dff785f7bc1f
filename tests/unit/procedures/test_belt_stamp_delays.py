"""What a run of picking says of the delays of camera and encoder."""

import pytest

from procedures.belt.result import BeltTrackingResult, PickingAnswer
from procedures.belt.stamp_delays import delay_warnings, delays_95_s
from procedures.belt.words import belt_tracking_lines

MEASURED = {"effective": 0.008, "applied": 0.0, "sigma": 0.0003}
CONFIGURED = {"effective": 0.008, "applied": 0.008}


def test_measured_delays_leave_their_uncertainty_together() -> None:
    offsets = {"fixed_camera": MEASURED, "belt": MEASURED | {"sigma": 0.0004}}
    assert delays_95_s(offsets) == pytest.approx(1.96 * 0.0005)
    assert delay_warnings(offsets) == []


@pytest.mark.parametrize(
    ("offsets", "devices", "jobs"),
    [
        ({}, "of the camera and encoder are", 'source = "fixed_camera" and source = "belt"'),
        ({"fixed_camera": MEASURED}, "of the encoder are", 'with source = "belt"'),
        ({"fixed_camera": CONFIGURED, "belt": MEASURED}, "of the camera are", 'with source = "fixed_camera"'),
    ],
)
def test_a_delay_that_was_not_measured_is_named_with_what_measures_it(
    offsets: dict[str, dict[str, float]], devices: str, jobs: str
) -> None:
    (warning,) = delay_warnings(offsets)
    assert warning.code == "belt.delays"
    assert devices in warning.text
    assert warning.text.endswith(jobs)
    assert delays_95_s(offsets) is None


@pytest.mark.parametrize("known_s", [None, 0.001])
def test_what_they_may_cost_is_said_in_words(known_s: float | None) -> None:
    answer = PickingAnswer.model_construct(
        picks=3, seen=3, misses={}, success=1.0, duration_s=9.0, picks_per_minute=20.0, follow=True,
        method="ml", delays_95_s=known_s,
    )  # fmt: skip
    lines = belt_tracking_lines(BeltTrackingResult.model_construct(result=answer))
    told = [line for line in lines if "known to 1.00 ms (95 %): all contacts may be off by 0.100 mm" in line]
    assert len(told) == (known_s is not None)
