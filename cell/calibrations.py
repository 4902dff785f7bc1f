"""What the ledger calls a calibration. A tool's belong to the tool, so a changed tool never inherits them."""

from collections.abc import Mapping
from typing import Any

OF_A_TOOL = ("T_flange_tool", "laser_reference")  # sorts that belong to a tool


def tool_calibration(tool: str) -> str:
    """``T_flange_tool`` of the tool with this name."""
    return f"T_flange_tool.{tool}"


def laser_reference(tool: str) -> str:
    """The crossed-beam reference of the tool with this name."""
    return f"laser_reference.{tool}"


def time_offset(device: str) -> str:
    """The constant delay of a device's stamps, s."""
    return f"time_offset_s.{device}"


def camera_in_delay(stated: Mapping[str, Any], camera: str, version: int | None) -> float | None:
    """s, standard deviation: what the delay of an encoder has of the error of its camera's in effect, by what
    the encoder's result has ``stated``. 0: it was measured by another camera or version; None: nobody knows.

    ``camera`` is the name of the camera's delay, for which versions count, and ``version`` that in effect.
    """
    by = stated.get("camera_calibration"), stated.get("camera_version")
    if None in by:
        return None
    if by != (camera, version):
        return 0.0
    part = stated.get("camera_sigma_s")
    return None if part is None else float(part)


def kinematics(device: str) -> str:
    """The calibrated ROBOT of an arm."""
    return f"kinematics.{device}"


def belt_scale(device: str) -> str:
    """Metres per count and direction of the belt whose encoder this is."""
    return f"belt.{device}"


def sort_of(name: str) -> str:
    """What a calibration is of, as ``T_flange_tool``: its name without the tool or device it belongs to."""
    return name.partition(".")[0]


def on_flange(name: str) -> bool:
    """Whether a value says where something on the flange is, which is known through the arm's kinematics."""
    return name.startswith("T_flange_")


def in_base(name: str) -> bool:
    """Whether a value brings what is measured into the base, known through the arm's kinematics."""
    return name.startswith(("T_base_", "laser_reference.", "belt."))


def rests_on_kinematics(name: str) -> bool:
    """Whether a value means something else when the arm's kinematics are others."""
    return on_flange(name) or in_base(name)
