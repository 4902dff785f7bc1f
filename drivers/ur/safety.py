"""From the safety bits and modes of a package to the coded error they mean."""

from dataclasses import dataclass

from cell.devices import SafetyMode

ROBOT_RUNNING = 7

PROTECTIVE = 1 << 2
SAFEGUARD = 1 << 4
EMERGENCY = 1 << 5 | 1 << 6 | 1 << 7  # system, robot, either
VIOLATION = 1 << 8
FAULT = 1 << 9

_ROBOT_MODES = {
    -1: "no controller",
    0: "disconnected",
    1: "confirm safety",
    2: "booting",
    3: "power off",
    4: "power on",
    5: "idle, brakes on",
    6: "backdrive",
    7: "running",
    8: "updating firmware",
}


@dataclass(frozen=True, slots=True)
class SafetyFinding:
    """An error by its catalogue name, with what was seen."""

    name: str
    detail: str


def safety_finding(robot_mode: int, safety_mode: int, bits: int) -> SafetyFinding | None:
    """The worst thing that one package shows, or None when the arm may move.

    ``bits`` are RTDE's safety_status_bits. The modes are looked at as well, because the two do not
    change in the same cycle on every version.
    """
    seen = f"safety mode {safety_mode}, bits {bits:#05x}, robot mode {robot_mode}"
    emergency = (SafetyMode.SYSTEM_EMERGENCY_STOP, SafetyMode.ROBOT_EMERGENCY_STOP)
    if bits & EMERGENCY or safety_mode in emergency:
        return SafetyFinding("ARM_EMERGENCY_STOP", seen)
    if bits & (VIOLATION | FAULT) or safety_mode in (SafetyMode.VIOLATION, SafetyMode.FAULT):
        return SafetyFinding("ARM_PROTECTIVE_STOP", f"safety violation or fault, {seen}")
    if bits & PROTECTIVE or safety_mode == SafetyMode.PROTECTIVE_STOP:
        return SafetyFinding("ARM_PROTECTIVE_STOP", seen)
    if bits & SAFEGUARD or safety_mode == SafetyMode.SAFEGUARD_STOP:
        return SafetyFinding("ARM_SAFEGUARD_STOP", seen)
    if robot_mode != ROBOT_RUNNING:
        return SafetyFinding(
            "ARM_NOT_READY", f"the arm is in mode {_ROBOT_MODES.get(robot_mode, robot_mode)}, {seen}"
        )
    if safety_mode == SafetyMode.REDUCED:
        return SafetyFinding("ARM_NOT_READY", f"reduced mode: jobs need the arm's full speed, {seen}")
    if safety_mode != SafetyMode.NORMAL:
        return SafetyFinding("ARM_NOT_READY", f"safety mode {safety_mode} is not normal, {seen}")
    return None
