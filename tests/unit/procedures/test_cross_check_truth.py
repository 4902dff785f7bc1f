"""A named part beside what has truly changed: every wrong answer disagrees."""

from collections.abc import Mapping
from typing import Any

import pytest

from cell.formats.result import read_as
from procedures.cross_check.result import CrossCheckResult
from procedures.cross_check.truth import judge_change
from tests.kit.whole_results import whole

STILL: Mapping[str, Any] = {
    "T_flange_tool": [0.0, 0.0, 0.18, 0.0, 0.0, 0.0],
    "mechanical": {"T_flange_camera": [0.0, -0.08, 0.05, 0.0, 0.0, 0.0]},
    "robot": {"error": {"delta_theta": [0.0] * 6}},
}
BENT = {**STILL, "T_flange_tool": [0.0009, -0.0012, 0.18, 0.0, 0.0, 0.0]}  # by 1.5 mm
MOVED = {**STILL, "mechanical": {"T_flange_camera": [0.001, -0.08, 0.05, 0.0, 0.0, 0.0]}}
LOST = {**STILL, "robot": {"error": {"delta_theta": [0.0, 0.0, 0.001, 0.0, 0.0, 0.0]}}}
BOTH = {**BENT, "robot": LOST["robot"]}


def found(part: str, **figures: Any) -> CrossCheckResult:
    document = {"kind": "cross-check", "verdict": "fail", "result": {"part": part, "probable": {}, **figures}}
    return read_as(CrossCheckResult, whole(document))


TOOL = found("tool", t=0.00148, t_sigma=2e-5)
NOTHING, OPEN = found("none"), found("cannot-tell", probable={"tool": 0.9})
CAMERA = found("camera", t=0.001, t_sigma=2e-5, r=0.0, r_sigma=1e-5)
ELBOW, BASE = (found("joint zero", joint=name, r=0.001, r_sigma=1e-5) for name in ("elbow", "base"))
ALL = (TOOL, NOTHING, OPEN, CAMERA, ELBOW, BASE)


@pytest.mark.parametrize(
    ("now", "right"),
    [
        (BENT, TOOL),
        (STILL, NOTHING),
        (MOVED, CAMERA),
        (LOST, ELBOW),
        (BOTH, OPEN),
    ],
)
def test_only_what_alone_has_changed_agrees(now: Mapping[str, Any], right: CrossCheckResult) -> None:
    assert [one for one in ALL if judge_change(one, STILL, now).good] == [right]
    wrong = judge_change(BASE, STILL, now)
    assert "NOT consistent" in wrong.text
    assert wrong.off.startswith("truly: ")


def test_a_part_that_moved_by_more_than_is_stated_disagrees() -> None:
    assert judge_change(TOOL, STILL, BENT).off == "0.020 mm"
    far = judge_change(found("tool", t=0.0013, t_sigma=2e-5), STILL, BENT)
    assert (far.good, far.off) == (False, "0.200 mm")
    assert "NOT consistent" in far.text


def test_a_camera_that_only_turned_is_held_against_its_angle() -> None:
    turned = {**STILL, "mechanical": {"T_flange_camera": [0.0, -0.08, 0.05, 0.0, 0.002, 0.0]}}
    right = found("camera", t=1e-5, t_sigma=2e-5, r=0.00201, r_sigma=1e-5)
    assert judge_change(right, STILL, turned).good
    wrong = judge_change(found("camera", t=1e-5, t_sigma=2e-5, r=0.0015, r_sigma=1e-5), STILL, turned)
    assert (wrong.good, "NOT consistent" in wrong.text) == (False, True)


def test_a_zero_that_is_off_by_more_than_is_stated_disagrees() -> None:
    far = found("joint zero", joint="elbow", r=0.0013, r_sigma=1e-5)
    assert not judge_change(far, STILL, LOST).good
