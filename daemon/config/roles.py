"""The roles of ``[robot]``: what each asks of its device, and the status bit that shows it to a PLC."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from cell.devices import Arm, DepthCamera, DigitalInputs, Encoder, Gripper, ObservedArm
from cell.kinds import plays
from cell.laser_tracker import LaserTracker


@dataclass(frozen=True)
class Role:
    """``protocol`` is what the device must be, ``kind`` the same in words.

    ``status_bit`` is the name, in the table of registers, of the bit that says the device is ready; None:
    there is none.
    """

    protocol: type
    kind: str
    status_bit: str | None = None


ROLES: dict[str, Role] = {
    "arm": Role(Arm, "an arm that can be moved", "arm ok"),
    "observed_arm": Role(ObservedArm, "an arm that is only read"),
    "flange_camera": Role(DepthCamera, "a camera", "camera ok"),
    "fixed_camera": Role(DepthCamera, "a camera", "camera ok"),
    "beams": Role(DigitalInputs, "a group of digital inputs", "beams ok"),
    "belt": Role(Encoder, "an encoder", "encoder ok"),
    "tracker": Role(LaserTracker, "a laser tracker", "tracker ok"),
    "gripper": Role(Gripper, "a gripper"),
    "place_inputs": Role(DigitalInputs, "a group of digital inputs"),
}


def kind_of(driver: Any) -> str:
    """What a driver's devices are, in words."""
    kinds = {role.kind for role in ROLES.values() if plays(driver, role.protocol)}
    return " or ".join(sorted(kinds)) or "of no known kind (its class has no PLAYS)"


def devices_by_role(named: Mapping[str, Any], devices: Iterable[str]) -> dict[str, str]:
    """The device of each role: the one that ``[robot]`` names, else the one that has the role's name."""
    known = set(devices)
    wanted = {role: named.get(role) or role for role in ROLES}
    return {role: name for role, name in wanted.items() if isinstance(name, str) and name in known}
