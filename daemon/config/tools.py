"""``[tool.NAME]``: one of several tools; a start says which one is on the flange."""

from collections.abc import Mapping
from typing import Any

from pydantic import Field

from daemon.config.findings import Findings, did_you_mean
from daemon.config.section import Point, Pose6, Section
from daemon.config.tables import table, tables

NAME = r"^[\w-]{1,32}$"  # a part of the names of its calibrations
HIGHEST_CHANGER = 65535


class NamedToolSection(Section):
    """One of several tools of the cell. A start says which one is on the flange, as its argument ``tool``."""

    T_flange_tool: Pose6 = Field(description="nominal pose of the tool's point in the flange")
    radius_m: float = Field(
        default=0.03, gt=0, le=1.0, description="of the capsule that stands for the tool in checks of motion"
    )
    payload_kg: float | None = Field(
        default=None,
        ge=0,
        le=100.0,
        description="mass on the flange while this tool is there; else that of [robot]",
    )
    centre_of_mass_m: Point | None = Field(
        default=None, description="centre of mass of that payload, in the flange, m; else that of [robot]"
    )
    changer: int | None = Field(
        default=None,
        ge=1,
        le=HIGHEST_CHANGER,
        description="number by which a PLC names the tool (argument_3 of a start); without it it cannot",
    )


def known_tools(raw: Mapping[str, Any]) -> list[str]:
    """The names of the tools of parsed TOML: the plain ``[robot] tool`` first, if it is one of them."""
    named = list(tables(raw.get("tool")))
    return [_plain_name(raw), *named] if has_plain_tool(raw) else named


def has_plain_tool(raw: Mapping[str, Any]) -> bool:
    """Whether ``[robot] tool`` is one of the tools: it was written, or there is no other."""
    return not tables(raw.get("tool")) or isinstance(table(raw, "robot").get("tool"), dict)


def usual_name(raw: Mapping[str, Any]) -> str | None:
    """The tool of a start that names none, nor its job: the plain one, or the only one; else None."""
    known = known_tools(raw)
    return known[0] if has_plain_tool(raw) or len(known) == 1 else None


def check_tools(raw: Mapping[str, Any], findings: Findings) -> None:
    """Tools that cannot be told apart, and jobs that name a tool that there is not."""
    seen: dict[int, str] = {}
    for name, section in tables(raw.get("tool")).items():
        if has_plain_tool(raw) and name == _plain_name(raw):
            findings.add(("tool", name), "[robot] tool has this name, too; give each tool a name of its own")
        number = section.get("changer")
        if type(number) is int and (other := seen.setdefault(number, name)) != name:
            text = f"{number} is the number of [tool.{other}], too; each tool needs its own"
            findings.add(("tool", name, "changer"), text)
    known = known_tools(raw)
    for job, section in tables(raw.get("job")).items():
        check_tool_of(section, ("job", job), known, findings)


def check_tool_of(
    section: Mapping[str, Any], place: tuple[str, ...], known: list[str], findings: Findings
) -> None:
    """Whether the tool of a job's section or of a recipe, if it names one, is one of the ``known``."""
    name = section.get("tool")
    if name is None or (isinstance(name, str) and name in known):
        return
    if not isinstance(name, str):
        findings.add((*place, "tool"), "should be the name of a tool")
    else:
        hint = did_you_mean(name, known) or f"; there is {', '.join(known)}"
        findings.add((*place, "tool"), f"there is no tool '{name}'{hint}")


def _plain_name(raw: Mapping[str, Any]) -> str:
    return str(table(table(raw, "robot"), "tool").get("name", "flange"))
