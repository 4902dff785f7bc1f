"""The immutable set of values that a run works with, resolved once at its start.

The effective value of a calibration is the committed version, else the configured one. Drivers and
procedures never read the ledger; what is here is also what ``run.json`` keeps.
"""

from collections.abc import Mapping
from typing import Any

from cell.calibrations import belt_scale, kinematics, laser_reference, time_offset, tool_calibration
from cell.errors import error
from cell.procedure import Procedure
from cell.store.ledger import Effective, Ledger
from daemon.config import CellConfig
from daemon.supervisor import Supervisor
from procedures.kinematics_in_use import CONTROLLER, choose_model

INPUT_ROLES = ("beams",)  # whose time offset a job can measure
ARM_ROLES = ("arm", "observed_arm")  # whose kinematics a job can measure
CALIBRATIONS = {
    # setup of a capture: (ledger name, keys of [robot] with the nominal poses)
    "eye-in-hand": ("T_flange_camera", {"X": "T_flange_camera_nominal"}),
    "eye-to-hand": ("T_base_camera", {"X": "T_base_camera_nominal", "W": "T_flange_target_nominal"}),
}


def configured_values(config: CellConfig) -> dict[str, Any]:
    """Arms, tool, payload, limits and poses as the configuration alone has them; JSON-able."""
    robot = config.robot
    return {
        "robot": robot.robot_spec(),
        "observed_robot": robot.observed_robot_spec(),
        "tool": robot.tool.model_dump(mode="json"),
        "use_kinematics": robot.use_kinematics,
        "payload_kg": robot.payload_kg,
        "centre_of_mass_m": list(robot.centre_of_mass_m),
        "limits": config.limits.model_dump(mode="json"),
        "poses": {name: list(q) for name, q in config.poses.items()},
    }


def resolve_values(config: CellConfig, ledger: Ledger, supervisor: Supervisor) -> dict[str, Any]:
    """JSON-able values; ``RESULT_CONFLICT`` when a configured value was edited under a committed one."""
    values: dict[str, Any] = {
        **configured_values(config),
        "robot": robot_spec(config, supervisor),
        "targets": {name: dict(spec) for name, spec in config.target.items()},
        "calibration": {},
        "configured": {},
        "versions": {},
        "made_with": {},  # the model of the arm, for each committed value
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
            _note_version(values, name, effective)
        values["calibration"][setup] = nominal or None
    _resolve_tool(values, config, ledger)
    _resolve_time_offsets(values, config, ledger)
    _resolve_kinematics(values, config, ledger)
    _resolve_belt(values, config, ledger)
    return values


def _resolve_tool(values: dict[str, Any], config: CellConfig, ledger: Ledger) -> None:
    """The tool's pose in effect, and the crossed-beam reference that belongs to this tool."""
    tool = config.robot.tool
    name = tool_calibration(tool.name)
    values["tool"]["T_flange_tool"] = _effective(values, ledger, name, list(tool.T_flange_tool))
    values["laser_reference"] = _effective(values, ledger, laser_reference(tool.name), None)
    values["laser_floor_m"] = config.job_section("laser-reference").get("floor_m")


def _resolve_belt(values: dict[str, Any], config: CellConfig, ledger: Ledger) -> None:
    """Metres per count and direction of the belt, as calibrated, else as configured."""
    device = config.robot.roles().get("belt")
    values["belt"] = None
    if device is not None:
        nominal = config.job_section("belt-tracking").get("belt")
        values["belt"] = _effective(values, ledger, belt_scale(device), nominal)


def _resolve_time_offsets(values: dict[str, Any], config: CellConfig, ledger: Ledger) -> None:
    """By role, the offset in effect and what the driver has already subtracted from its stamps."""
    values["time_offset_s"] = {}
    for role in INPUT_ROLES:
        device = config.robot.roles().get(role)
        if device is None:
            continue
        applied = float(getattr(config.device[device], "time_offset_s", 0.0))
        effective = _effective(values, ledger, time_offset(device), applied)
        values["time_offset_s"][role] = {"effective": effective, "applied": applied}


def _resolve_kinematics(values: dict[str, Any], config: CellConfig, ledger: Ledger) -> None:
    """By role, the calibrated arm in effect (what ``tracker-sampling`` proposed); None while there is none.

    It says where the true flange is, and a run works with it when ``use_kinematics`` says so. The controller
    goes on to believe its own model, which is ``robot``.
    """
    devices = config.robot.roles()
    values["kinematics"] = {
        role: _effective(values, ledger, kinematics(devices[role]), None)
        for role in ARM_ROLES
        if role in devices
    }


def _effective(values: dict[str, Any], ledger: Ledger, name: str, configured: Any) -> Any:
    values["configured"][name] = configured
    effective = ledger.effective(name, configured)
    if effective.conflict:
        raise error(
            "RESULT_CONFLICT", f"the configured value of {name} was edited since version {effective.version}"
        )
    if effective.version is not None:
        _note_version(values, name, effective)
    return effective.value


def _note_version(values: dict[str, Any], name: str, effective: Effective) -> None:
    values["versions"][name] = effective.version
    values["made_with"][name] = effective.arm_model or dict(CONTROLLER)


def with_arm_model(
    values: dict[str, Any], procedure: Procedure, config: CellConfig, supervisor: Supervisor
) -> dict[str, Any]:
    """``values`` with the model of the arm that a run of ``procedure`` works with, as ``arm_model``.

    ``KINEMATICS_MISSING`` or ``KINEMATICS_OTHER_ARM`` when the config asks for one that there is not.
    """
    if procedure.judges_arm:
        return {**values, "arm_model": dict(CONTROLLER)}
    device = config.robot.roles().get("arm")
    entry = supervisor.devices.get(device or "")
    serial = None if entry is None or entry.identity is None else entry.identity.serial
    return {**values, "arm_model": choose_model(values, device, serial)}


def without_passes(values: Mapping[str, Any]) -> dict[str, Any]:
    """The values as ``run.json`` keeps them; the passes of a reference are in the run's own data set."""
    reference = values.get("laser_reference")
    if reference is None:
        return dict(values)
    return {**values, "laser_reference": {k: v for k, v in reference.items() if k != "passes"}}


def tell_configured(config: CellConfig, ledger: Ledger) -> None:
    """Let the ledger know the configured values of today, against which it judges a decision."""
    for name, nominal_keys in CALIBRATIONS.values():
        ledger.effective(name, _nominal(config, nominal_keys).get("X"))
    tool = config.robot.tool
    ledger.effective(tool_calibration(tool.name), list(tool.T_flange_tool))
    ledger.effective(laser_reference(tool.name), None)
    if (belt := config.robot.roles().get("belt")) is not None:
        ledger.effective(belt_scale(belt), config.job_section("belt-tracking").get("belt"))
    for role in ARM_ROLES:
        if (device := config.robot.roles().get(role)) is not None:
            ledger.effective(kinematics(device), None)
    for role in INPUT_ROLES:
        if (device := config.robot.roles().get(role)) is not None:
            applied = float(getattr(config.device[device], "time_offset_s", 0.0))
            ledger.effective(time_offset(device), applied)


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
