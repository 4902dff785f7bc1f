"""The nominal scale of a belt: the way of a count, or the wheel that the encoder sits on."""

from typing import Any

import pytest
from pydantic import ValidationError

from daemon.config.models import NominalBelt

ALONG_X = [1.0, 0.0, 0.0]


def test_a_wheel_gives_the_way_of_a_count_with_its_sign() -> None:
    wheel = NominalBelt(wheel_circumference_m=0.2, counts_per_revolution=-2000, dir=ALONG_X)
    assert wheel.scale == pytest.approx(-0.0001)
    assert NominalBelt(m_per_count=0.0003, dir=ALONG_X).scale == 0.0003


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({}, "give m_per_count, or wheel_circumference_m and counts_per_revolution"),
        ({"wheel_circumference_m": 0.2}, "give m_per_count, or"),
        (
            {"m_per_count": 0.1, "wheel_circumference_m": 0.2, "counts_per_revolution": 100},
            "give m_per_count, or",
        ),
        ({"wheel_circumference_m": 0.2, "counts_per_revolution": 0}, "must not be 0"),
        ({"m_per_count": 0.0}, "must not be 0"),
    ],
)
def test_a_scale_that_is_missing_half_given_or_given_twice_is_refused(
    given: dict[str, Any], words: str
) -> None:
    with pytest.raises(ValidationError, match=words):
        NominalBelt(**given, dir=ALONG_X)
