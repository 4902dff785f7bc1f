"""The immutable set of values that a run works with, resolved once at its start.

The effective value of a calibration is the committed version, else the configured one. Drivers and
procedures never read the ledger; what is here is also what ``run.json`` keeps.
"""

from typing import Any

from cell.errors import error
from cell.store.ledger import Ledger
from daemon.config import CellConfig
from daemon.supervisor import Supervisor

CALIBRATIONS = {
    # setup of a capture: (ledger name, keys of [robot] with the nominal poses)
    "eye-in-hand": ("T_flange_camera", {"X": "T_flange_camera_nominal"}),
    "eye-to-hand": ("T_base_camera", {"X": "T_base_camera_nominal", "W": "T_flange_target_nominal"}),
}


def resolve_values(config: CellConfig, ledger: Ledger, supervisor: Supervisor) -> dict[str, Any]:
    """JSON-able values; ``RESULT_CONFLICT`` when a configured value was edited under a committed one."""
    robot = config.robot
    values: dict[str, Any] = {
        "robot": robot_spec(config, supervisor),
        "tool": robot.tool.model_dump(mode="json"),
        "payload_kg": robot.payload_kg,
        "centre_of_mass_m": list(robot.centre_of_mass_m),
        "limits": config.limits.model_dump(mode="json"),
        "poses": {name: list(q) for name, q in config.poses.items()},
        "targets": {name: dict(spec) for name, spec in config.target.items()},
        "calibration": {},
        "configured": {},
        "versions": {},
    }
    for setup, (name, nominal_keys) in CALIBRATIONS.items():
        nominal = _nominal(config, nominal_keys)
        values["configured"][name] = nominal.get("X")
        effective = ledger.effective(name, nominal.get("X"))
        if effective.conflict:
            raise error(
                "RESULT_CONFLICT",
                f"[robot] {nominal_keys['X']} was edited since {name} version {effective.version}",
            )
        if effective.version is not None:
            nominal["X"] = effective.value
            values["versions"][name] = effective.version
        values["calibration"][setup] = nominal or None
    return values


def tell_configured(config: CellConfig, ledger: Ledger) -> None:
    """Let the ledger know the configured values of today, against which it judges a decision."""
    for name, nominal_keys in CALIBRATIONS.values():
        ledger.effective(name, _nominal(config, nominal_keys).get("X"))


def _nominal(config: CellConfig, keys: dict[str, str]) -> dict[str, list[float]]:
    values = {k: getattr(config.robot, key) for k, key in keys.items()}
    return {k: list(v) for k, v in values.items() if v is not None}


def robot_spec(config: CellConfig, supervisor: Supervisor) -> dict[str, Any]:
    """The ROBOT of FORMATS: the configured model with the factory calibration that the controller reports."""
    arm = supervisor.devices.get(config.robot.roles().get("arm", ""))
    spec = dict(config.robot.robot_spec())
    if arm is not None and arm.identity is not None and "calibration" not in spec:
        factory = arm.identity.extra.get("kinematics", {}).get("calibration")
        if factory is not None:
            spec["calibration"] = factory
    return spec
