"""What ``check`` says of the zone against approach, descent and grip, and of T1 against the longest way."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calibration.belt.arm_time import MotionLimits, rest_to_rest
from cell.poses import from_pose6
from daemon.predictions import setup_of
from procedures.arm_setup import believed_arm
from procedures.belt.config import BeltTrackingConfig
from procedures.belt.expectation import belt_expectation
from procedures.belt.motion.cycle_estimate import CycleEstimate
from procedures.belt.motion.tool_joints import ToolJoints
from tests.kit.picking_cell import JOB, picking_config

CLASSIC = {"method": "classic", "follow": False}


def expected(folder: Path, **job: Any) -> tuple[dict[str, Any], BeltTrackingConfig]:
    config = picking_config(folder, job)
    section = BeltTrackingConfig.model_validate(config.job[JOB])
    found = belt_expectation(setup_of(config), section)
    assert not found["problems"]
    return found, section


def test_the_speed_is_the_zone_over_t1_descent_and_dwell_for_the_classic_method(tmp_path: Path) -> None:
    found, job = expected(tmp_path, **CLASSIC, T1_s=0.9)
    axis = MotionLimits(job.limits.speed_m_s, job.limits.accel_m_s2, job.limits.jerk_m_s3)
    descent = float(rest_to_rest(np.array(job.down_m), axis))
    fastest = (job.zone.max_m - job.zone.min_m) / (0.9 + descent + job.dwell_s)
    assert found["zone"]["fastest_m_s"] == pytest.approx(fastest)
    assert f"up to {fastest:.2f} m/s (approach 0.90 s" in found["text"]


def test_a_zone_that_is_too_short_is_named_with_the_speed_the_length_and_the_t1_that_would_do(
    tmp_path: Path,
) -> None:
    found, job = expected(tmp_path, **CLASSIC, T1_s=1.8)
    told = next(text for text in found["cautions"] if "too short" in text)
    fastest = found["zone"]["fastest_m_s"]
    assert fastest < 0.3
    assert told.startswith(f"above {fastest:.2f} m/s the zone of 0.55 m is too short for T1_s (1.80 s)")
    length = float(told.split("make it ")[1].split(" m long")[0])
    shorter = float(told.split(", or T1_s ")[1].split(" s")[0])
    for better in (
        {"zone": {"min_m": job.zone.min_m, "max_m": job.zone.min_m + length}, "T1_s": 1.8},
        {"T1_s": shorter},
    ):
        again, _ = expected(tmp_path, **CLASSIC, **better)
        assert again["zone"]["fastest_m_s"] >= 0.3 - 1e-9
        assert not any("too short" in text for text in again["cautions"])


def test_a_t1_that_is_shorter_than_the_longest_way_is_named_with_the_one_that_is_not(tmp_path: Path) -> None:
    found, _ = expected(tmp_path, **CLASSIC, T1_s=0.1)
    told = next(text for text in found["cautions"] if text.startswith("T1_s = 0.1 s is shorter than the way"))
    enough = float(told.split("raise T1_s to ")[1].split(" s")[0])
    again, _ = expected(tmp_path, **CLASSIC, T1_s=enough)
    assert not any("T1_s =" in text for text in again["cautions"])


def test_a_tool_that_follows_needs_the_zone_for_its_gripper_too(tmp_path: Path) -> None:
    usual, job = expected(tmp_path)
    slow, _ = expected(tmp_path, grip_timeout_s=4.5)
    assert usual["zone"]["grip_s"] == pytest.approx(job.grip_timeout_s / 3.0)
    assert slow["zone"]["grip_s"] == pytest.approx(1.5)
    told = next(text for text in slow["cautions"] if "too short" in text)
    assert "too short for the approach" in told
    assert "T1_s" not in told


def estimates(folder: Path, *speeds: float | list[float]) -> list[CycleEstimate]:
    """Of the picking cell, whose joints may turn so fast."""
    config = picking_config(folder)
    values = setup_of(config).values
    q_wait, q_place = (np.array(values.poses[name]) for name in ("wait", "place"))
    tool = ToolJoints(believed_arm(values), from_pose6(values.tool["T_flange_tool"]), q_wait)
    jobs = (BeltTrackingConfig(**config.job[JOB] | {"limits": {"joint_speed_rad_s": one}}) for one in speeds)
    return [CycleEstimate(job, tool, q_wait, q_place, np.array([1.0, 0.0, 0.0])) for job in jobs]


def test_ways_are_planned_within_the_limit_of_each_joint(tmp_path: Path) -> None:
    one, each, slow = (made.zone_times() for made in estimates(tmp_path, 1.5, [1.5] * 6, [0.3, *[1.5] * 5]))
    assert one == each
    assert slow.approach_s > 2.0 * one.approach_s


def test_the_joint_that_is_too_slow_to_follow_is_named_with_its_own_limit(tmp_path: Path) -> None:
    made = estimates(tmp_path, 1.5, [0.2, *[1.5] * 5], [*[1.5] * 5, 0.01])
    found = [estimate.too_fast_to_follow(0.3) for estimate in made]
    assert found[0] is None
    assert [(beyond[0], beyond[2]) for beyond in found[1:] if beyond] == [("base", 0.2), ("wrist 3", 0.01)]
