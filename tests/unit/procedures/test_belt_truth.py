"""A calibrated belt beside the twin's true one."""

from math import cos, sin
from pathlib import Path

import pytest

from procedures.belt.result import BeltAnswer, BeltCalibrationResult, BeltUncertainty
from procedures.belt.truth import judge_belt
from procedures.beside_truth import Judged

TRUE_M, OFF, TURN_RAD, RISE95 = 1e-5, 0.0004, 0.001, 0.004


def judged(half_share: float, turn95_rad: float | None, rise_rad: float = 0.001) -> Judged:
    answer = BeltAnswer(
        m_per_count=TRUE_M * (1.0 + OFF),
        dir=[cos(rise_rad) * cos(TURN_RAD), cos(rise_rad) * sin(TURN_RAD), sin(rise_rad)],
        m_per_count_95=None,
        dir_95_rad=RISE95,
        travel_m=1.0,
        sightings=10,
        items=2,
    )
    of = BeltUncertainty(
        half_m_per_count=half_share * TRUE_M,
        half_dir_rad=RISE95,
        half_level_rad=turn95_rad,
        half_rise_rad=RISE95,
        cov=None,
        mostly_from=None,
    )
    found = BeltCalibrationResult.model_construct(result=answer, uncertainty=of)
    return judge_belt(found, {"belt": {"m_per_count": TRUE_M, "dir": [1.0, 0.0, 0.0]}}, Path())


@pytest.mark.parametrize(("half_share", "turn95_rad", "good"), [(0.001, 0.002, True), (0.0002, 0.002, False)])
def test_each_error_is_its_share_of_the_limit_that_is_stated(
    half_share: float, turn95_rad: float, good: bool
) -> None:
    rise_rad = 0.002
    subject = judged(half_share, turn95_rad, rise_rad)
    assert subject.good is good
    assert subject.inside95 is good
    assert subject.limits95 == {
        "travel of one count": (pytest.approx(half_share), "1"),
        "direction": (turn95_rad, "rad"),
        "rise": (RISE95, "rad"),
    }
    off = {name: subject.of95[name] * size for name, (size, _) in subject.limits95.items()}
    assert off == pytest.approx(
        {"travel of one count": OFF, "direction": TURN_RAD, "rise": rise_rad}, rel=1e-6
    )


def test_a_row_says_which_figure_is_the_travel_and_which_the_direction() -> None:
    subject = judged(0.001, 0.002)
    assert subject.stated == "travel of one count 0.100 %, direction 0.115 deg (95 %)"
    assert subject.off == "travel of one count 0.040 %, direction 0.057 deg"


def test_a_rise_beyond_what_is_stated_is_told_and_not_taken_for_the_direction() -> None:
    subject = judged(0.001, 0.002, rise_rad=0.009)
    assert not subject.good
    assert subject.off == judged(0.001, 0.002).off
    assert "rise 0.516 deg" in subject.text
    assert "rise 0.229 deg" in subject.text


def test_a_result_of_before_the_planes_were_stated_is_judged_by_the_wider_of_both() -> None:
    subject = judged(0.001, None)
    assert subject.limits95["direction"] == (RISE95, "rad")
