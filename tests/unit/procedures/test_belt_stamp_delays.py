"""What a run of picking says of the delays of camera and encoder."""

import pytest

from procedures.belt.result import BeltTrackingResult, PickingAnswer
from procedures.belt.stamp_delays import camera_delay_95_s, delay_warnings
from procedures.belt.words import belt_tracking_lines

MEASURED = {"effective": 0.008, "applied": 0.0, "sigma": 0.0003}
CONFIGURED = {"effective": 0.008, "applied": 0.008}
CAMERA = ("of the camera are", "every contact off by 1 mm along the belt at 0.1 m/s", '"fixed_camera"')
ENCODER = ("of the encoder are", "where the belt's speed changes by 0.1 m/s between", '"belt"')


@pytest.mark.parametrize("encoder", [{}, {"belt": CONFIGURED}, {"belt": MEASURED | {"sigma": 0.0004}}])
def test_the_delay_of_the_camera_alone_says_how_far_all_contacts_may_be_off(
    encoder: dict[str, dict[str, float]],
) -> None:
    assert camera_delay_95_s({"fixed_camera": MEASURED, **encoder}) == pytest.approx(1.96 * 0.0003)
    assert camera_delay_95_s({"fixed_camera": CONFIGURED, **encoder}) is None
    assert camera_delay_95_s(encoder) is None


@pytest.mark.parametrize(
    ("offsets", "told"),
    [
        ({}, [CAMERA, ENCODER]),
        ({"fixed_camera": MEASURED}, [ENCODER]),
        ({"fixed_camera": CONFIGURED, "belt": MEASURED}, [CAMERA]),
        ({"fixed_camera": MEASURED, "belt": MEASURED}, []),
    ],
)
def test_a_delay_that_was_not_measured_is_named_with_its_cost_and_what_measures_it(
    offsets: dict[str, dict[str, float]], told: list[tuple[str, str, str]]
) -> None:
    warnings = delay_warnings(offsets)
    assert [w.code for w in warnings] == ["belt.delays"] * len(told)
    for warning, (device, cost, source) in zip(warnings, told, strict=True):
        assert device in warning.text
        assert cost in warning.text
        assert warning.text.endswith(f"run latency-calibration with source = {source}")


@pytest.mark.parametrize("known_s", [None, 0.001])
def test_what_it_may_cost_is_said_in_words(known_s: float | None) -> None:
    answer = PickingAnswer.model_construct(
        picks=3, seen=3, misses={}, success=1.0, duration_s=9.0, picks_per_minute=20.0, follow=True,
        method="ml", camera_delay_95_s=known_s, camera_95_m=known_s,
    )  # fmt: skip
    lines = belt_tracking_lines(BeltTrackingResult.model_construct(result=answer))
    words = "delay of the camera is known to 1.00 ms (95 %): all contacts may be off by 0.100 mm"
    assert len([line for line in lines if words in line]) == (known_s is not None)
    words = "camera's pose and lens all contacts may be off by 1.000 mm (95 %)"
    assert len([line for line in lines if words in line]) == (known_s is not None)
