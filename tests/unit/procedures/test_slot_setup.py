"""What a configuration alone says of insertions: what it refuses, and what ``cellward check`` finds."""

from collections.abc import Mapping
from typing import Any

import pytest
from pydantic import ValidationError

from cell.run_values import RunValues
from drivers.ur.gripper import ArmGripperConfig
from fakes.world.scenario import Scenario
from procedures.setup import Setup
from procedures.slot.config import SlotInsertionConfig
from procedures.slot.expectation import slot_expectation

ROLES = {"arm": "arm", "flange_camera": "camera", "gripper": "gripper"}
HAND_EYE = {"name": "T_flange_camera", "state": "committed"}


def section(**changes: Any) -> dict[str, Any]:
    """The job of the scenario with other keys; a table's keys are merged."""
    known = Scenario.load("slot").cell.job["slot-insertion"]
    merged = {k: {**known.get(k, {}), **v} if isinstance(v, Mapping) else v for k, v in changes.items()}
    return {**known, **merged}


def expected(
    job: dict[str, Any],
    roles: Mapping[str, str] = ROLES,
    known: bool = True,
    devices: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    poses = {"home": [0.0] * 6, "feed": [0.0] * 6, "put_down": [0.0] * 6}
    values = RunValues(robot={"model": "ur10e"}, poses=poses)
    setup = Setup(roles, devices or {}, values, {}, [], lambda: [HAND_EYE] if known else [])
    return slot_expectation(setup, SlotInsertionConfig.model_validate(job))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"part": {"width_m": 0.041}}, "as large as the opening"),
        ({"opening": {"chamfer_m": 0.001}}, "as large as the opening"),
        ({"slot": 7}, "slot 7 is none of the rack's 6"),
        ({"insertion": {"clear_m": 0.02}}, "stand out by 0.04 m"),
        ({"action": "replace", "fetch_pose": None}, "give fetch_pose and put_down_pose"),
    ],
)
def test_what_cannot_be_inserted_is_refused_in_words(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        SlotInsertionConfig.model_validate(section(**changes))


def test_a_chamfer_is_given_no_credit() -> None:
    job = SlotInsertionConfig.model_validate(
        section(opening={"width_m": 0.043, "height_m": 0.023, "chamfer_m": 0.001})
    )
    assert job.clearance_m == pytest.approx(0.0005)


def test_check_says_what_part_and_rack_alone_leave_open() -> None:
    found = expected(section())
    assert found["clearance_m"] == pytest.approx(0.0005)
    # 0.1 mm, and sqrt(1.0^2 + 1.5^2) mrad over 60 mm, by the 95 % of a circle
    assert found["part_and_rack_95_m"] == pytest.approx(
        2.4477 * (1e-8 + (1.803e-3 * 0.06) ** 2) ** 0.5, rel=1e-3
    )
    assert (found["problems"], found["cautions"]) == (
        [],
        ["part and rack alone take most of the room: measure them better, or expect refusals"],
    )


def test_check_finds_what_would_refuse_every_insertion() -> None:
    found = expected(section(part={"sigma_rad": 0.004}))
    assert "every insertion would be refused" in found["problems"][0]


def test_check_names_a_role_and_a_pose_that_are_missing() -> None:
    found = expected(section(fetch_pose="feeder"), roles={"arm": "arm", "flange_camera": "camera"})
    assert any("gripper" in problem for problem in found["problems"])
    assert any("fetch_pose = 'feeder' is not in [poses]" in problem for problem in found["problems"])


def test_check_asks_for_a_calibrated_camera() -> None:
    assert any("run cone-capture" in caution for caution in expected(section(), known=False)["cautions"])


@pytest.mark.parametrize(("moves_s", "where"), [(2.5, "problems"), (1.9, "cautions"), (0.5, None)])
def test_check_compares_the_grippers_own_time_with_the_timeout(moves_s: float, where: str | None) -> None:
    gripper = ArmGripperConfig(output=0, moves_s=moves_s)
    found = expected(section(), devices={"gripper": gripper})
    told = {key: [text for text in found[key] if "moves_s" in text] for key in ("problems", "cautions")}
    assert {key for key, texts in told.items() if texts} == ({where} if where else set())
    for text in (text for texts in told.values() for text in texts):
        assert text.startswith("insertion.grip_timeout_s = 2 s, and [device.gripper] moves_s is")
