"""The devices of a twin: which object stands in for each role, and what it has of the cell's own section."""

from collections.abc import Mapping
from typing import Any

# The driver of the object face that stands in for a device, by role.
DRIVERS = {
    "arm": "fakes.object:ObjectArm",
    "flange_camera": "fakes.object:ObjectCamera",
    "fixed_camera": "fakes.object:ObjectCamera",
    "beams": "fakes.object:ObjectInputs",
    "tracker": "fakes.object:ObjectTracker",
    "belt": "fakes.object:ObjectEncoder",
    "gripper": "fakes.object:ObjectGripper",
    "place_inputs": "fakes.object:ObjectPlaceInputs",
    "observed_arm": "fakes.object:ObjectObservedArm",
}
# What their sections have besides: an arm goes to what it is asked for, by its program or by a person.
KEYS = {"observed_arm": {"allow_requests": True}}
# Keys of an object by the key of the cell's own section that says the same.
_CAMERA = {"lost_after_s": "frame_timeout_s"}
_SAME: Mapping[str, Mapping[str, str]] = {
    "arm": {
        key: key
        for key in (
            "servo_lookahead_s",
            "servo_gain",
            "joint_tolerance_rad",
            "position_tolerance_m",
            "rotation_tolerance_rad",
        )
    },
    "flange_camera": _CAMERA,
    "fixed_camera": _CAMERA,
    "beams": {"poll_period_s": "poll_period_s"},
    "place_inputs": {"poll_period_s": "poll_period_s"},
    "tracker": {"min_readings": "min_readings"},
    "belt": {"lost_after_s": "lost_after_s"},
    "observed_arm": {key: key for key in ("poll_period_s", "rest_window_s", "rest_spread_rad")},
}


# An object that is asked rarely is not lost meanwhile: the least silence that ends its link, s, and that many
# times its period.
_SILENT_S = {"beams": 0.1, "place_inputs": 0.5, "observed_arm": 0.5, "tracker": 1.0}
_PERIODS = 3.0
_LOST_S = 10.0  # the longest silence that an object takes


def device_keys(role: str, section: Any, arm: Any) -> dict[str, Any]:
    """Keys of the object that stands in for the device of ``role``, from its ``section`` and that of the
    arm; what the section does not have stays as the object has it."""
    keys = {
        key: getattr(section, told) for key, told in _SAME.get(role, {}).items() if hasattr(section, told)
    }
    if role in ("beams", "place_inputs") and hasattr(section, "arm") and hasattr(arm, "rtde_frequency_hz"):
        keys["poll_period_s"] = 1.0 / arm.rtde_frequency_hz  # inputs of the arm come with its state
    if (least_s := _SILENT_S.get(role)) and hasattr(section, "poll_period_s"):
        keys["lost_after_s"] = min(max(least_s, _PERIODS * section.poll_period_s), _LOST_S)
    if role == "gripper" and getattr(section, "confirm", 0) is None:
        keys["counts_after_s"] = getattr(section, "moves_s", None)
    return {**KEYS.get(role, {}), **keys}
