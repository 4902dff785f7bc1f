"""What no single section can say: units that look wrong, names that lead nowhere, contradictions."""

import math
from collections.abc import Iterator, Mapping
from typing import Any

from cell.joint_limits import limit_words
from daemon.config.findings import Findings, did_you_mean
from daemon.config.limits_section import LimitsSection
from daemon.config.locate import Path
from daemon.config.roles import ROLES, devices_by_role
from daemon.config.tables import table

MAX_LENGTH_M = 20.0
MAX_ANGLE_RAD = 4.0 * math.pi
OAKS = {"oak", "drivers.oak:OakCamera"}
LONG_FILTER_S = 0.02  # of an input of light beams
SIGN_WAS_PLUS = OAKS | {"ur", "drivers.ur:UrArm"}
CALIBRATED_ROLES = {  # of each key of [check_due]
    "T_flange_camera": ("flange_camera",),
    "T_base_camera": ("fixed_camera",),
    "T_flange_tool": ("arm",),
    "laser_reference": ("beams",),
    "kinematics": ("arm", "observed_arm"),
    "belt": ("belt",),
    "time_offset_s": ("beams", "flange_camera", "fixed_camera", "belt"),
}
LARGEST = 1e300  # TOML's whole numbers have no limit; NaN compares with nothing


def check_units(raw: Mapping[str, Any], findings: Findings) -> None:
    """Numbers that only make sense in millimetres or degrees, and numbers that are none."""
    for path, value in _numbers(raw):
        names = [p for p in path if isinstance(p, str)]
        key = names[-1] if names else ""
        if not -LARGEST <= value <= LARGEST:
            bound = f"of at most {LARGEST:g} in size"
            findings.add(path, f"should be a finite number {bound}, not {str(value)[:20]}")
        elif _is_length(path, key) and abs(value) > MAX_LENGTH_M:
            findings.add(path, f"{value:g} m is probably millimetres; lengths are in metres")
        elif _is_angle(path, key, names) and abs(value) > MAX_ANGLE_RAD:
            findings.add(path, f"{value:g} rad is probably degrees; angles are in radians")


def check_names(raw: Mapping[str, Any], findings: Findings) -> None:
    """Roles name devices, jobs name targets, poses and inputs."""
    devices, targets, poses = (table(raw, key) for key in ("device", "target", "poses"))
    for role, name in table(raw, "robot").items():
        if role in ROLES and isinstance(name, str) and name not in devices:
            findings.add(("robot", role), f"there is no [device.{name}]{did_you_mean(name, devices)}")
    for place, section in _job_sections(raw):
        for key, name in section.items():
            if key == "target" and isinstance(name, str) and name not in targets:
                findings.add((*place, key), f"there is no [target.{name}]{did_you_mean(name, targets)}")
            if key.endswith("_pose"):
                _check_pose((*place, key), name, poses, findings)
            elif isinstance(name, dict):
                _check_pose((*place, key, "aux"), name.get("aux"), poses, findings)
    _check_inputs(raw, findings)


def _check_pose(place: Path, name: Any, poses: Mapping[str, Any], findings: Findings) -> None:
    """A pose is taught with the daemon running, so a job whose pose is missing does not keep it from that."""
    if not isinstance(name, str) or name in poses:
        return
    text = f"there is no '{name}' in [poses]{did_you_mean(name, poses)}"
    if place[0] == "job":
        findings.add_problem(place, f"{text}; bring the arm there, then 'cellward pose save {name}'")
    else:
        findings.add(place, text)


def _check_inputs(raw: Mapping[str, Any], findings: Findings) -> None:
    """Jobs name inputs of the device that has the role ``beams``, where its section lists them."""
    device = table(raw, "robot").get("beams", "beams")
    section = table(raw, "device").get(device) if isinstance(device, str) else None
    if not isinstance(section, dict):
        return
    inputs = section.get("inputs")
    for place, keys in _job_sections(raw):
        for key, value in keys.items():
            name = value.get("input") if isinstance(value, dict) else None
            if isinstance(name, str) and isinstance(inputs, dict) and name not in inputs:
                findings.add(
                    (*place, key, "input"),
                    f"[device.{device}] has no input '{name}'; it has {', '.join(inputs) or 'none'}",
                )


def check_contradictions(raw: Mapping[str, Any], findings: Findings) -> None:
    """Settings that exclude each other, and settings that can hardly be meant."""
    _check_twin(raw, findings)
    _check_modbus(raw, findings)
    _check_limits(raw, findings)
    _check_time_offsets(raw, findings)
    _check_exposure(raw, findings)
    _check_due(raw, findings)
    _check_filter(raw, findings)
    _check_tool(raw, findings)
    if table(raw, "robot").get("use_kinematics") is True and not _has_arm(raw):
        findings.add(("robot", "use_kinematics"), "there is no arm whose kinematics could be used")


def _has_arm(raw: Mapping[str, Any]) -> bool:
    return "arm" in table(raw, "robot") or "arm" in table(raw, "device")


def _check_tool(raw: Mapping[str, Any], findings: Findings) -> None:
    if not _has_arm(raw) or table(raw, "cell").get("twin", False) is not False:
        return
    if "tool" not in table(raw, "robot") and not table(raw, "tool"):
        text = "is missing, so nothing is expected beyond the flange: measure the tool, or write {}"
        findings.warn(("robot", "tool"), text)


def _check_twin(raw: Mapping[str, Any], findings: Findings) -> None:
    cell = table(raw, "cell")
    twin = cell.get("twin", False)
    for name, section in table(raw, "device").items():
        serial = section.get("expect_serial") if isinstance(section, dict) else None
        if isinstance(serial, str) and isinstance(twin, bool) and serial.startswith("9999") != twin:
            what = "is a twin's" if serial.startswith("9999") else "is not a twin's (those begin with 9999)"
            findings.add(
                ("device", name, "expect_serial"), f"'{serial}' {what}, but cell.twin is {str(twin).lower()}"
            )
    if cell.get("clock") is not None and twin is not True:
        findings.add(("cell", "clock"), "another clock is only possible with twin = true")


def _check_time_offsets(raw: Mapping[str, Any], findings: Findings) -> None:
    """A file that was written for the other sign would shift the stamps by twice the offset."""
    for name, section in table(raw, "device").items():
        if not isinstance(section, dict):
            continue
        driver, offset = section.get("driver"), section.get("time_offset_s")
        if isinstance(driver, str) and driver in SIGN_WAS_PLUS and _is_number(offset) and offset != 0:
            findings.warn(
                ("device", name, "time_offset_s"),
                f"{offset:g} s is subtracted from the stamps, as for every device; an arm and a camera added"
                " it in configurations of November 2026 and before: change the sign of such a value",
            )


def _check_due(raw: Mapping[str, Any], findings: Findings) -> None:
    """A rule about a calibration that this cell cannot have would never say anything."""
    there = devices_by_role(table(raw, "robot"), table(raw, "device"))
    for key in table(raw, "check_due"):
        roles = CALIBRATED_ROLES.get(key, ())
        if roles and not any(role in there for role in roles):
            text = f"this cell has no device with the role {' or '.join(roles)}; take the rule out"
            findings.add(("check_due", key), text)


def _check_exposure(raw: Mapping[str, Any], findings: Findings) -> None:
    """Automatic exposure goes up to about a frame's time before it raises the gain."""
    robot, devices = table(raw, "robot"), table(raw, "device")
    name = robot.get("fixed_camera")
    section = devices.get(name) if isinstance(name, str) and "belt" in robot else None
    if not isinstance(section, dict) or section.get("driver") not in OAKS:
        return
    if section.get("source", "oak") != "oak" or "exposure_s" in section:
        return
    fps = section.get("fps", 10.0)
    if _is_number(fps) and fps > 0:
        findings.warn(
            ("device", str(name), "exposure_s"),
            f"is missing, so exposure is automatic and lasts up to {1.0 / fps:.2g} s: each 0.1 m/s of the "
            f"belt smears an item over {100.0 / fps:.2g} mm; give a time, as 0.002",
        )


def _check_filter(raw: Mapping[str, Any], findings: Findings) -> None:
    """Modules filter their inputs as delivered, some by a tenth of a second; the wire does not tell it."""
    name = table(raw, "robot").get("beams", "beams")
    section = table(raw, "device").get(name)
    if not isinstance(section, dict) or section.get("driver") != "modbus-inputs":
        return
    filter_s, place = section.get("filter_s"), ("device", str(name), "filter_s")
    if filter_s is None:
        findings.warn(
            place,
            "is missing: set the filter of these inputs in the module to its shortest time, and say here what"
            " it is; a long one delays every edge, and swallows a beam that is broken for a shorter time",
        )
    elif _is_number(filter_s) and filter_s > LONG_FILTER_S:
        findings.warn(
            place,
            f"{filter_s:g} s is long: at 10 mm/s a beam has to be broken for {1e1 * filter_s:.2g} mm to be"
            " seen at all; set a shorter filter in the module",
        )


def _check_modbus(raw: Mapping[str, Any], findings: Findings) -> None:
    modbus = table(raw, "modbus")
    if modbus.get("allow_write") is True and not modbus.get("allow_clients"):
        findings.warn(("modbus", "allow_write"), "allow_clients is empty, so no client can write")


def _check_limits(raw: Mapping[str, Any], findings: Findings) -> None:
    limits = {**LimitsSection().model_dump(), **table(raw, "limits")}
    if _has_arm(raw) and not limits["workspace"]:
        findings.add(("limits",), "no workspace is given; an arm needs one box at least to stay within")
    if limits.get("allow_job_override") is True:
        return
    for place, section in _job_sections(raw):
        wanted = section.get("limits")
        for key, high in wanted.items() if isinstance(wanted, dict) else ():
            allowed: Any = limits.get(key)
            pairs = zip(in_each_joint(high), in_each_joint(allowed), strict=True)
            if any(one > most for one, most in pairs):
                findings.warn(
                    (*place, "limits", key),
                    f"{limit_words(high)} is above {limit_words(allowed)} of [limits], and "
                    "allow_job_override is false",
                )


def in_each_joint(limit: Any) -> list[float]:
    """The limit (6,) of each joint, as one number or six have it; what is neither is beyond nothing."""
    if _is_number(limit):
        return [limit] * 6
    if isinstance(limit, list) and len(limit) == 6 and all(_is_number(one) for one in limit):
        return limit
    return [math.nan] * 6


def _numbers(value: Any, path: Path = ()) -> Iterator[tuple[Path, float]]:
    if _is_number(value):
        yield path, value
    elif isinstance(value, dict):
        for key, item in value.items():
            yield from _numbers(item, (*path, key))
    elif isinstance(value, list):
        for index, item in enumerate(value):
            yield from _numbers(item, (*path, index))


def _is_length(path: Path, key: str) -> bool:
    """Keys in metres, boxes, points, and the first three numbers of a pose."""
    if key.startswith("T_"):
        return path[-1] in (0, 1, 2)
    return (key.endswith("_m") and not key.endswith("_per_m")) or key in ("min", "max")


def _is_angle(path: Path, key: str, names: list[str]) -> bool:
    """Keys in radians, joints, and the last three numbers of a pose."""
    if key.startswith("T_"):
        return path[-1] in (3, 4, 5)
    return key.endswith("_rad") or names[0] == "poses"


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _job_sections(raw: Mapping[str, Any]) -> Iterator[tuple[tuple[str, str], dict[str, Any]]]:
    """Each table with arguments of a job, ``[job.NAME]`` and ``[recipe.NAME]``, with its place."""
    for kind in ("job", "recipe"):
        for name, section in table(raw, kind).items():
            if isinstance(section, dict):
                yield (kind, name), section
