"""Values that are well formed and cannot be meant: addresses, payload, poses beyond what the arm can do."""

import ipaddress
import re
from collections.abc import Mapping
from math import pi
from typing import Any
from urllib.parse import urlsplit

from daemon.config.findings import Findings
from daemon.config.tables import tables
from daemon.config.targets import DICTIONARY_SIZES

# Rated payloads, kg, as the maker lists its models (universal-robots.com); where one has two, the greater:
# ur10e 10 or 12.5, by the label on the arm (its user manual, "Maximum Payload"); ur8long 8 or 10, ur15 15 or
# 17.5, ur20 20 or 25.
PAYLOAD_KG = {
    "ur3": 3.0, "ur5": 5.0, "ur10": 10.0, "ur3e": 3.0, "ur5e": 5.0, "ur7e": 7.5, "ur10e": 12.5, "ur12e": 12.5,
    "ur16e": 16.0, "ur8long": 10.0, "ur15": 17.5, "ur18": 18.0, "ur20": 25.0, "ur30": 35.0,
}  # fmt: skip
JOINT_RANGE_RAD = 2.0 * pi
UNITS_RAD = 4.0 * pi  # from here on the number is taken for degrees
_DOTTED = re.compile(r"[\d.]+")


def check_plausible(raw: Mapping[str, Any], findings: Findings) -> None:
    """One finding for each value that cannot work, whatever the models say of its form."""
    _check_addresses(raw, findings)
    _check_payload(raw, findings)
    _check_poses(raw, findings)
    _check_boards(raw, findings)


def _check_addresses(raw: Mapping[str, Any], findings: Findings) -> None:
    for name, section in tables(raw.get("device")).items():
        host, url = section.get("host"), section.get("url")
        if isinstance(host, str) and (why := _host_fault(host)):
            findings.add(("device", name, "host"), why)
        if isinstance(url, str) and "://" in url and (why := _url_fault(url)):
            findings.add(("device", name, "url"), why)


def _host_fault(host: str) -> str | None:
    if "://" in host or "/" in host:
        return f"'{host}' should be a host name or an address alone"
    head, colon, port = host.rpartition(":")
    if colon and ":" not in head and port.isdecimal():
        return f"'{host}' should have no port; write '{head}'"
    return _impossible_address(host)


def _url_fault(url: str) -> str | None:
    try:
        return _impossible_address(urlsplit(url).hostname or "")
    except ValueError:
        return None  # the driver's own model says what is wrong with the form


def _impossible_address(host: str) -> str | None:
    if not _DOTTED.fullmatch(host):
        return None
    try:
        ipaddress.ip_address(host)
    except ValueError:
        return f"'{host}' is no IP address: those have four numbers from 0 to 255"
    return None


def _check_payload(raw: Mapping[str, Any], findings: Findings) -> None:
    robot = raw.get("robot")
    section = robot if isinstance(robot, dict) else {}
    model = section.get("model", "ur10e")
    most = PAYLOAD_KG.get(model) if isinstance(model, str) else None
    loads = {("robot",): section} | {("tool", n): s for n, s in tables(raw.get("tool")).items()}
    for place, load in loads.items():
        mass = load.get("payload_kg")
        if most is not None and isinstance(mass, int | float) and mass > most:
            text = f"{mass:g} kg is more than a {model} carries ({most:g} kg)"
            findings.add((*place, "payload_kg"), text)


def _check_poses(raw: Mapping[str, Any], findings: Findings) -> None:
    poses, limits = raw.get("poses"), raw.get("limits")
    ranges = limits.get("joint_ranges_rad") if isinstance(limits, dict) else None
    for name, joints in poses.items() if isinstance(poses, dict) else ():
        for index, angle in enumerate(joints if isinstance(joints, list) else ()):
            if not _is_number(angle) or abs(angle) > UNITS_RAD:
                continue
            if abs(angle) > JOINT_RANGE_RAD + 1e-6:
                findings.add(
                    ("poses", name, index),
                    f"{angle:g} rad is beyond the joint's range of -{JOINT_RANGE_RAD:.4g} to "
                    f"{JOINT_RANGE_RAD:.4g} rad (360 deg)",
                )
            elif (ends := _ends(ranges, index)) and not ends[0] - 1e-9 <= angle <= ends[1] + 1e-9:
                findings.add(
                    ("poses", name, index),
                    f"{angle:g} rad is beyond limits.joint_ranges_rad of joint {index + 1}, {ends[0]:g} to "
                    f"{ends[1]:g} rad; widen it, or teach the pose elsewhere",
                )


def _ends(ranges: Any, index: int) -> list[float] | None:
    """The range of one joint, where it has the form of one."""
    ends = ranges[index] if isinstance(ranges, list) and index < len(ranges) else None
    formed = isinstance(ends, list) and len(ends) == 2 and all(map(_is_number, ends)) and ends[0] < ends[1]
    return ends if formed else None


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _check_boards(raw: Mapping[str, Any], findings: Findings) -> None:
    """The dictionary exists, and has a marker for every place of the board."""
    for name, section in tables(raw.get("target")).items():
        dictionary, place = section.get("dictionary"), ("target", name, "dictionary")
        if not isinstance(dictionary, str):
            continue
        known = {d.casefold(): d for d in DICTIONARY_SIZES}
        if dictionary not in DICTIONARY_SIZES:
            near = known.get(dictionary.casefold())
            hint = f"did you mean '{near}'?" if near else "as in DICT_5X5_100"
            findings.add(place, f"OpenCV has no dictionary '{dictionary}', {hint}")
            continue
        there = DICTIONARY_SIZES[dictionary]
        columns, rows = section.get("squares_x"), section.get("squares_y")
        if isinstance(columns, int) and isinstance(rows, int) and columns * rows // 2 > there:
            findings.add(
                place,
                f"{columns} x {rows} squares need {columns * rows // 2} markers, {dictionary} has {there}",
            )
        marker = section.get("id")
        if isinstance(marker, int) and marker >= there:
            findings.add(("target", name, "id"), f"{dictionary} has the markers 0 to {there - 1}")
