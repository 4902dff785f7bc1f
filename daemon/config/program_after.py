"""``[robot.program_after]``: the arm's own program that is started again after a check that it asked for."""

import ipaddress
from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import AfterValidator, Field

from cell.devices import StartsPrograms
from cell.kinds import plays
from daemon.config.drivers import driver_class
from daemon.config.findings import Findings
from daemon.config.section import Section

JOB = "laser-check"  # what the shipped URScript asks for


def _address(value: str) -> str:
    ipaddress.ip_address(value)
    return value


class ProgramAfter(Section):
    """Without this table no program of others is started. With it, after a ``laser-check`` that passed."""

    program: str = Field(
        pattern=r"^[A-Za-z0-9_./ -]+\.urp$",
        max_length=200,
        description="program of the arm's controller, as its dashboard server loads it: work.urp",
    )
    asked_from: Annotated[str, AfterValidator(_address)] = Field(
        description="address of the robot as the Modbus server sees it; a check that another client, the "
        "page or a person asked for starts nothing"
    )


def check_program_after(
    raw: Mapping[str, Any],
    devices: Mapping[str, Any],
    roles: Mapping[str, str],
    findings: Findings,
    drivers: Mapping[str, str],
) -> None:
    """What else has to be in ``cell.toml`` so that a robot can ask, and its program be started."""
    robot = raw.get("robot")
    section = robot.get("program_after") if isinstance(robot, Mapping) else None
    if not isinstance(section, Mapping):
        return
    place = ("robot", "program_after")
    arm = devices.get(roles.get("arm", ""))
    if "arm" not in roles:
        findings.add(place, "there is no arm that has programs; add one, or remove the table")
    elif arm is not None and not plays(driver_class(arm.driver, drivers), StartsPrograms):
        findings.add(place, f"the driver '{arm.driver}' of the arm starts no programs; remove the table")
    asked_from, modbus = section.get("asked_from"), raw.get("modbus")
    server = modbus if isinstance(modbus, Mapping) else {}
    if server.get("enabled") is False or server.get("allow_write") is not True:
        findings.add((*place, "asked_from"), "no robot can ask: set enabled and allow_write in [modbus]")
    elif isinstance(asked_from, str) and not _listed(asked_from, server.get("allow_clients")):
        findings.add((*place, "asked_from"), f"'{asked_from}' is not in allow_clients of [modbus]; add it")


def _listed(address: str, networks: Any) -> bool:
    try:
        found = ipaddress.ip_address(address)
        return any(found in ipaddress.ip_network(network) for network in networks or ())
    except (TypeError, ValueError):
        return True  # what is wrong with them is found where they are read
