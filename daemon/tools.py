"""The tools of a cell: which there are, and which one a start means."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from cell.errors import error
from daemon.config import CellConfig

ARGUMENT = "tool"


@dataclass(frozen=True)
class CellTool:
    """A tool as configured: pose (6,) in the flange, m and rad, and the load on the flange while it is there.

    ``changer`` is the number by which a PLC names it, None where it has none.
    """

    name: str
    T_flange_tool: Sequence[float]
    radius_m: float
    payload_kg: float
    centre_of_mass_m: Sequence[float]
    changer: int | None = None

    def load(self) -> dict[str, Any]:
        """The keys of ``[robot]`` that say what the flange carries with it."""
        return {"payload_kg": self.payload_kg, "centre_of_mass_m": list(self.centre_of_mass_m)}

    def section(self) -> dict[str, Any]:
        """As a run has it in its values."""
        return {
            "name": self.name,
            "T_flange_tool": list(self.T_flange_tool),
            "radius_m": self.radius_m,
        }


def tool_names(config: CellConfig) -> list[str]:
    """The names of the cell's tools, that of ``[robot] tool`` first."""
    return [*([config.robot.tool.name] if config.robot.plain_tool else []), *config.tool]


def tools_of(config: CellConfig) -> dict[str, CellTool]:
    """Every tool of the cell by its name, that of ``[robot] tool`` first."""
    robot, plain = config.robot, config.robot.tool
    mass, centre = robot.payload_kg, list(robot.centre_of_mass_m)
    found = {}
    if robot.plain_tool:
        found[plain.name] = CellTool(plain.name, plain.T_flange_tool, plain.radius_m, mass, centre)
    for name, tool in config.tool.items():
        found[name] = CellTool(
            name,
            tool.T_flange_tool,
            tool.radius_m,
            mass if tool.payload_kg is None else tool.payload_kg,
            centre if tool.centre_of_mass_m is None else tool.centre_of_mass_m,
            tool.changer,
        )
    return found


def usual_tool(config: CellConfig, job: str = "") -> CellTool | None:
    """The tool of a start that names none: that of ``[job.NAME]``, of ``[robot]``, or the only one.

    None where a start has to say which it is.
    """
    tools = tools_of(config)
    named = config.job.get(job, {}).get(ARGUMENT)
    if named is not None:
        return tools[named]
    if config.robot.plain_tool or len(tools) == 1:
        return next(iter(tools.values()))
    return None


def asked_tool(config: CellConfig, job: str, asked: str | None, needed: bool) -> CellTool | None:
    """The tool of a start of ``job`` that asks for this one, None: for none.

    ``ARGUMENT_INVALID`` for a tool that there is not, and for none where one is ``needed``, with those known.
    """
    tools = tools_of(config)
    if asked is None:
        tool = usual_tool(config, job)
        if tool is None and needed:
            text = f"{job} needs a tool: say which one is on the flange, tool={' or tool='.join(tools)}"
            raise error("ARGUMENT_INVALID", text)
        return tool
    if asked not in tools:
        raise error("ARGUMENT_INVALID", f"there is no tool '{asked}'; there is {', '.join(tools)}")
    return tools[asked]


def loaded_tool(config: CellConfig, job: str, asked: str | None, needed: bool) -> CellTool | None:
    """As :func:`asked_tool`, for a start: ``CONFIG_INVALID`` where the tool is ``needed`` and nobody has
    stated its load, which the controller is told. A twin without one carries nothing."""
    tool = asked_tool(config, job, asked, needed)
    if needed and tool is not None and not (config.cell.twin or _load_is_stated(config, tool.name)):
        raise error(
            "CONFIG_INVALID",
            f"{config.source}: [robot] payload_kg is missing: weigh what is on the flange with tool "
            f"'{tool.name}', or write 0.0 for nothing",
        )
    return tool


def _load_is_stated(config: CellConfig, tool: str) -> bool:
    own = config.tool.get(tool)
    return config.robot.load_stated or (own is not None and own.payload_kg is not None)


def tools_by_changer(config: CellConfig) -> dict[int, str]:
    """The tools that a PLC can name, by their number."""
    return {tool.changer: tool.name for tool in tools_of(config).values() if tool.changer is not None}


def told_tool(config: CellConfig, tool: Mapping[str, Any]) -> str | None:
    """The name of a run's tool where it says something: in a cell with several, of a run that has one."""
    return str(tool["name"]) if tool and len(tool_names(config)) > 1 else None
