"""Which arm a configuration names: one that is known, or a ROBOT in a file beside it."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import Field

from cell.errors import CellError
from cell.formats.robot import parse_robot
from cell.store.files import read_json
from daemon.config.checks import in_each_joint
from daemon.config.findings import Findings, did_you_mean, with_detail
from daemon.config.limits_section import LimitsSection
from daemon.config.models import UR_MODELS, DeviceSection, RobotSection

MAX_BYTES = 2**20


class ResolvedRobot(RobotSection):
    """``[robot]`` with its names resolved."""

    spec: dict[str, Any] = Field(default_factory=dict, description="the ROBOT of the data formats")
    observed_spec: dict[str, Any] | None = Field(default=None, description="the same of the observed arm")
    devices: dict[str, str] = Field(default_factory=dict, description="device by role")
    plain_tool: bool = Field(default=True, exclude=True, description="whether 'tool' is one of the cell's")
    load_stated: bool = Field(default=True, exclude=True, description="whether payload_kg was written")

    def roles(self) -> dict[str, str]:
        """The device that plays each role; a role nobody was named for goes to the device of its name."""
        return dict(self.devices)

    def robot_spec(self) -> dict[str, Any]:
        """The ROBOT of the data formats that ``model`` names."""
        return dict(self.spec)

    def observed_robot_spec(self) -> dict[str, Any] | None:
        """The ROBOT that ``observed_model`` names: what the observed arm's controller believes."""
        return None if self.observed_spec is None else dict(self.observed_spec)


def robot_spec(raw: Mapping[str, Any], findings: Findings, path: Path) -> dict[str, Any]:
    """The ROBOT that ``robot.model`` names: a known arm, or a JSON file beside the configuration."""
    section = raw.get("robot")
    model = section.get("model", "ur10e") if isinstance(section, dict) else "ur10e"
    place = ("robot", "model")
    spec = _named_robot(model, place, findings, path)
    if "family" not in spec:
        return spec
    from calibration.kinematics import robot_from_spec  # SciPy, which most configurations need not wait for

    try:
        parse_robot(spec, str(model))
        robot_from_spec(spec)
    except CellError as exc:
        findings.add(place, with_detail(exc))
        return {}
    _check_joint_speed(raw, spec["joint_speeds_rad_s"], str(model), findings)
    return spec


def _check_joint_speed(raw: Mapping[str, Any], fastest: list[float], model: str, findings: Findings) -> None:
    """No joint may be faster than the arm's own file has it."""
    section = raw.get("limits")
    allowed = section.get("joint_speed_rad_s") if isinstance(section, dict) else None
    wanted = in_each_joint(LimitsSection().joint_speed_rad_s if allowed is None else allowed)
    beyond = [k for k, (most, own) in enumerate(zip(wanted, fastest, strict=True)) if most > own]
    if beyond:
        worst = min(beyond, key=lambda k: fastest[k])
        place = ("limits",) if allowed is None else ("limits", "joint_speed_rad_s")
        text = f"joint_speed_rad_s of {wanted[worst]:g} is above {fastest[worst]:g} of joint {worst + 1}"
        findings.add(place, f"{text} in {model}; lower it, or give one number a joint")


def observed_spec(
    raw: Mapping[str, Any], devices: Mapping[str, DeviceSection | None], findings: Findings, path: Path
) -> dict[str, Any] | None:
    """The ROBOT that ``robot.observed_model`` names; it has as many joints as the device reads."""
    robot = raw.get("robot")
    section = robot if isinstance(robot, dict) else {}
    model = section.get("observed_model")
    if not isinstance(model, str):
        return None
    place = ("robot", "observed_model")
    spec = _named_robot(model, place, findings, path)
    if not spec:
        return None
    try:
        axes = parse_robot(spec, model).joints
    except CellError as exc:
        findings.add(place, with_detail(exc))
        return None
    name = section.get("observed_arm", "observed_arm")
    read = getattr(devices.get(name), "joints", None) if isinstance(name, str) else None
    if isinstance(read, list) and len(read) != axes:
        findings.add(("device", str(name), "joints"), f"reads {len(read)} joints, but {model} has {axes}")
    return spec


def _named_robot(model: Any, place: tuple[str, ...], findings: Findings, path: Path) -> dict[str, Any]:
    """The ROBOT called ``model``; empty, with a finding, when there is none."""
    if not isinstance(model, str) or model in UR_MODELS:
        return {"model": model}
    if not model.endswith(".json"):
        hint = did_you_mean(model, UR_MODELS) or f", there is {', '.join(UR_MODELS)}, or a file NAME.json"
        findings.add(place, f"there is no arm '{model}'{hint}")
        return {}
    try:
        spec = read_json(path.parent / model, max_bytes=MAX_BYTES)
    except CellError as exc:
        findings.add(place, with_detail(exc))
        return {}
    if not isinstance(spec, dict) or not {"model", "family"} & spec.keys():
        findings.add(place, f"{model} is no ROBOT: it has neither 'model' nor 'family'")
        return {}
    return spec
