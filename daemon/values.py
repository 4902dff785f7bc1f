"""The immutable set of values that a run works with, resolved once at its start.

The effective value of a calibration is the committed version, else the configured one. Drivers and
procedures never read the ledger; what is here is also what ``run.json`` keeps.
"""

from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import Any

from cell.calibrations import (
    belt_scale,
    camera_in_delay,
    kinematics,
    laser_reference,
    time_offset,
    tool_calibration,
)
from cell.errors import error
from cell.procedure import Procedure
from cell.run_values import CONTROLLER, RunValues
from cell.store.ledger import Ledger
from daemon.config import CellConfig
from daemon.controller_limits import beyond, limits_in_use, require_within, told_by
from daemon.supervisor import Supervisor
from daemon.tools import CellTool, tools_of, usual_tool
from procedures.arm_setup import with_job_limits
from procedures.kinematics_in_use import choose_model

STAMPED_ROLES = ("beams", "flange_camera", "fixed_camera", "belt")  # whose time offset a job can measure
ARM_ROLES = ("arm", "observed_arm")  # whose kinematics a job can measure
_SIGMAS95 = 1.96  # half of a 95 % interval
CALIBRATIONS = {
    # role of a camera: (ledger name, setup of its captures, keys of [robot] with the nominal poses)
    "flange_camera": ("T_flange_camera", "eye-in-hand", {"X": "T_flange_camera_nominal"}),
    "fixed_camera": (
        "T_base_camera",
        "eye-to-hand",
        {"X": "T_base_camera_nominal", "W": "T_flange_target_nominal"},
    ),
}


def configured_values(config: CellConfig, tool: CellTool | None = None) -> RunValues:
    """Arms, tool, payload, limits, poses and targets as the configuration alone has them.

    ``tool`` is what is on the flange; None: that of a start that names none, or nothing that is known of.
    """
    robot, tool = config.robot, tool or usual_tool(config)
    return RunValues(
        robot=robot.robot_spec(),
        observed_robot=robot.observed_robot_spec(),
        tool={} if tool is None else tool.section(),
        use_kinematics=robot.use_kinematics,
        payload_kg=robot.payload_kg if tool is None else tool.payload_kg,
        centre_of_mass_m=list(robot.centre_of_mass_m if tool is None else tool.centre_of_mass_m),
        limits=config.limits.model_dump(mode="json"),
        poses={name: list(q) for name, q in config.poses.items()},
        targets={name: dict(spec) for name, spec in config.target.items()},
        belt=_nominal_belt(config),
    )


def resolve_values(
    config: CellConfig,
    ledger: Ledger,
    supervisor: Supervisor,
    uses: Collection[str],
    tool: CellTool | None,
    reads_reference: bool = False,
) -> RunValues:
    """The values of a run that uses these roles: the ``tool``, the arm, and what is calibrated of the roles.

    The tool's laser reference is among them with the beams, and where the run ``reads_reference``.

    ``RESULT_CONFLICT`` when a configured value of those was edited under a committed one.
    """
    effect = _InEffect(ledger)
    roles = {role: name for role, name in config.robot.roles().items() if role in {"arm", *uses}}
    values = configured_values(config, tool)
    referred = reads_reference or "beams" in roles
    return replace(
        values,
        robot=robot_spec(config, supervisor),
        limits=limits_in_use(config, told_by(config, supervisor)),
        tool=values.tool if tool is None else _tool_in_effect(tool, effect),
        calibration=dict(
            _hand_eye(config, effect, *known) for role, known in CALIBRATIONS.items() if role in roles
        ),
        laser_reference=effect.value(laser_reference(tool.name), None) if tool and referred else None,
        belt=effect.value(belt_scale(roles["belt"]), values.belt) if "belt" in roles else None,
        time_offset_s=_with_camera_in_it(
            {role: _offset(config, effect, roles[role]) for role in STAMPED_ROLES if role in roles},
            effect,
            roles,
        ),
        # Where the true flange is; a run goes by it when ``use_kinematics`` says so.
        kinematics={role: effect.value(kinematics(roles[role]), None) for role in ARM_ROLES if role in roles},
        configured=effect.configured,
        versions=effect.versions,
        made_with=effect.made_with,
        uncertainty=effect.uncertainty,
    )


class _InEffect:
    """Calibrations as the ledger has them in effect, and what is known of each by its name."""

    def __init__(self, ledger: Ledger) -> None:
        self._ledger = ledger
        self.configured: dict[str, Any] = {}
        self.versions: dict[str, int] = {}
        self.made_with: dict[str, Mapping[str, Any]] = {}
        self.uncertainty: dict[str, Mapping[str, Any]] = {}

    def value(self, name: str, configured: Any, key: str = "") -> Any:
        """The version in effect, else what is ``configured`` (under ``key`` of ``[robot]``)."""
        self.configured[name] = configured
        found = self._ledger.effective(name, configured)
        if found.conflict:
            what = (
                f"[robot] {key} was edited since {name}"
                if key
                else f"the configured value of {name} was edited since"
            )
            raise error("RESULT_CONFLICT", f"{what} version {found.version}")
        if found.version is not None:
            self.versions[name] = found.version
            self.made_with[name] = found.arm_model or dict(CONTROLLER)
            if known := stated(found.result):
                self.uncertainty[name] = known
        return found.value


def stated(result: Mapping[str, Any] | None) -> dict[str, Any]:
    """What the result of a version says of its uncertainty, the lens that belongs to it, without an
    adjustment the one that was estimated before, and the target, with the printed size that was found; of a
    belt the intervals of scale and direction; of an encoder's delay what the camera has in it."""
    answer, inputs, spread = ((result or {}).get(part) or {} for part in ("result", "inputs", "uncertainty"))
    answer = {
        **answer,
        "lens": answer.get("lens") or answer.get("intrinsics"),
        "target": inputs.get("target"),
        "camera_version": inputs.get("camera_version"),
        "camera_calibration": inputs.get("camera_calibration"),
        "camera_sigma_s": spread.get("camera_sigma_s"),
        "half_level_rad": spread.get("half_level_rad"),
    }
    of_poses = ("cov", "budget", "arm", "interval95_s", "lens", "lens_cov", "target", "target_scale")
    of_encoder = ("camera_calibration", "camera_version", "camera_sigma_s")
    keys = (*of_poses, "m_per_count_95", "dir_95_rad", "half_level_rad", *of_encoder)
    return {key: answer[key] for key in keys if answer.get(key) is not None}


def _hand_eye(
    config: CellConfig, effect: _InEffect, name: str, setup: str, keys: dict[str, str]
) -> tuple[str, dict[str, Any] | None]:
    """What is known of a camera: its pose in effect as ``X``, beside the nominal pose of the target."""
    poses = _nominal(config, keys)
    X = effect.value(name, poses.get("X"), keys["X"])
    return setup, {**poses, "X": X} if X is not None else poses or None


def _tool_in_effect(tool: CellTool, effect: _InEffect) -> dict[str, Any]:
    pose = effect.value(tool_calibration(tool.name), list(tool.T_flange_tool))
    return {**tool.section(), "T_flange_tool": pose}


def _nominal_belt(config: CellConfig) -> dict[str, Any] | None:
    nominal = config.robot.belt_nominal
    return None if nominal is None else {"m_per_count": nominal.scale, "dir": nominal.dir}


def _offset(config: CellConfig, effect: _InEffect, device: str) -> dict[str, float]:
    """The offset in effect, what the driver has already subtracted from its stamps, and the standard
    deviation of a version in effect."""
    applied, name = float(getattr(config.device[device], "time_offset_s", 0.0)), time_offset(device)
    offset = {"effective": effect.value(name, applied), "applied": applied}
    if name in effect.versions:
        low, high = effect.uncertainty.get(name, {}).get("interval95_s", (0.0, 0.0))
        offset["sigma"] = 0.5 * (high - low) / _SIGMAS95
    return offset


def _with_camera_in_it(
    offsets: dict[str, dict[str, float]], effect: _InEffect, roles: Mapping[str, str]
) -> dict[str, dict[str, float]]:
    """``offsets`` by role; that of an encoder with the part of its ``sigma`` that the camera's version in
    effect brings, 0 where it was measured with another one, and without where its result does not tell."""
    if not {"belt", "fixed_camera"} <= roles.keys():
        return offsets
    encoder, camera = (time_offset(roles[role]) for role in ("belt", "fixed_camera"))
    stated = effect.uncertainty.get(encoder, {})
    part = camera_in_delay(stated, camera, effect.versions.get(camera))
    if "sigma" in offsets["belt"] and part is not None:
        offsets["belt"]["camera_sigma"] = part
    return offsets


def with_limits(
    values: RunValues, procedure: Procedure, told: Mapping[str, Any], place: str = ""
) -> RunValues:
    """``values`` with the limits that the job brings, and for a job that moves the arm none beyond those that
    the arm's controller ``told``: ``LIMITS_BEYOND_CONTROLLER`` where they are more than rounded.

    ``place`` is the section that they are from; without it, the job's.
    """
    values, section = _with_own_limits(values, procedure, place)
    if "arm" not in procedure.uses():
        return values
    return replace(values, limits=require_within(values.limits, told, section))


def beyond_controller(
    values: RunValues, procedure: Procedure, told: Mapping[str, Any], place: str = ""
) -> list[str]:
    """What :func:`with_limits` would refuse as beyond the controller, each limit by itself."""
    values, section = _with_own_limits(values, procedure, place)
    return beyond(values.limits, told, section) if "arm" in procedure.uses() else []


def _with_own_limits(values: RunValues, procedure: Procedure, place: str) -> tuple[RunValues, str]:
    """``values`` with the limits that the job brings, and where those of the joints' speeds stand."""
    of_job = getattr(procedure.config, "limits", None)
    own = hasattr(of_job, "joint_speed_rad_s")
    return with_job_limits(values, of_job), f"{place or f'job.{procedure.name}'}.limits" if own else "limits"


def with_arm_model(
    values: RunValues, procedure: Procedure, config: CellConfig, supervisor: Supervisor
) -> RunValues:
    """``values`` with the model of the arm that a run of ``procedure`` works with, as ``arm_model``.

    ``KINEMATICS_MISSING`` or ``KINEMATICS_OTHER_ARM`` when the config asks for one that there is not.
    """
    if procedure.judges_arm:
        return replace(values, arm_model=dict(CONTROLLER))
    device = config.robot.roles().get("arm")
    entry = supervisor.devices.get(device or "")
    serial = None if entry is None or entry.identity is None else entry.identity.serial
    return replace(values, arm_model=choose_model(values, device, serial))


def recorded(values: RunValues) -> dict[str, Any]:
    """The values as ``run.json`` keeps them; the passes of a reference are in the run's own data set."""
    reference = values.laser_reference
    if reference is not None:
        values = replace(values, laser_reference={k: v for k, v in reference.items() if k != "passes"})
    return values.as_dict()


def tell_configured(config: CellConfig, ledger: Ledger) -> None:
    """Let the ledger know the configured values of today, against which it judges a decision."""
    for name, _, nominal_keys in CALIBRATIONS.values():
        ledger.effective(name, _nominal(config, nominal_keys).get("X"))
    for tool in tools_of(config).values():
        ledger.effective(tool_calibration(tool.name), list(tool.T_flange_tool))
        ledger.effective(laser_reference(tool.name), None)
    if (belt := config.robot.roles().get("belt")) is not None:
        ledger.effective(belt_scale(belt), _nominal_belt(config))
    for role in ARM_ROLES:
        if (device := config.robot.roles().get(role)) is not None:
            ledger.effective(kinematics(device), None)
    for role in STAMPED_ROLES:
        if (device := config.robot.roles().get(role)) is not None:
            applied = float(getattr(config.device[device], "time_offset_s", 0.0))
            ledger.effective(time_offset(device), applied)


def _nominal(config: CellConfig, keys: dict[str, str]) -> dict[str, list[float]]:
    values = {k: getattr(config.robot, key) for k, key in keys.items()}
    return {k: list(v) for k, v in values.items() if v is not None}


def robot_spec(config: CellConfig, supervisor: Supervisor) -> dict[str, Any]:
    """The ROBOT that is configured, with the factory calibration that the controller reports."""
    arm = supervisor.devices.get(config.robot.roles().get("arm", ""))
    spec = dict(config.robot.robot_spec())
    if arm is not None and arm.identity is not None and not {"calibration", "family"} & spec.keys():
        factory = arm.identity.extra.get("kinematics", {}).get("calibration")
        if factory is not None:
            spec["calibration"] = factory
    return spec
