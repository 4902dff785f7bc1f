"""A calibrated belt beside the twin's true one."""

from math import cos, sin
from pathlib import Path

import pytest

from procedures.belt.result import BeltAnswer, BeltCalibrationResult, BeltUncertainty
from procedures.belt.truth import judge_belt
from procedures.beside_truth import Judged

TRUE_M, OFF, TURN_RAD = 1e-5, 0.0004, 0.001


def judged(half_share: float, turn95_rad: float) -> Judged:
    answer = BeltAnswer(
        m_per_count=TRUE_M * (1.0 + OFF),
        dir=[cos(TURN_RAD), sin(TURN_RAD), 0.0],
        m_per_count_95=None,
        dir_95_rad=turn95_rad,
        travel_m=1.0,
        sightings=10,
        items=2,
    )
    of = BeltUncertainty(
        half_m_per_count=half_share * TRUE_M, half_dir_rad=turn95_rad, cov=None, mostly_from=None
    )
    found = BeltCalibrationResult.model_construct(result=answer, uncertainty=of)
    return judge_belt(found, {"belt": {"m_per_count": TRUE_M, "dir": [1.0, 0.0, 0.0]}}, Path())


@pytest.mark.parametrize(("half_share", "turn95_rad", "good"), [(0.001, 0.002, True), (0.0002, 0.002, False)])
def test_each_error_is_its_share_of_the_limit_that_is_stated(
    half_share: float, turn95_rad: float, good: bool
) -> None:
    subject = judged(half_share, turn95_rad)
    assert subject.good is good
    assert subject.inside95 is good
    assert subject.limits95 == {
        "travel of one count": (pytest.approx(half_share), "1"),
        "direction": (turn95_rad, "rad"),
    }
    off = {name: subject.of95[name] * size for name, (size, _) in subject.limits95.items()}
    assert off == pytest.approx({"travel of one count": OFF, "direction": TURN_RAD}, rel=1e-6)


def test_a_row_says_which_figure_is_the_travel_and_which_the_direction() -> None:
    subject = judged(0.001, 0.002)
    assert subject.stated == "travel of one count 0.100 %, direction 0.115 deg (95 %)"
    assert subject.off == "travel of one count 0.040 %, direction 0.057 deg"
