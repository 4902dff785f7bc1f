"""Registers of what was put into effect last, and of the tool's pose: numbers for a robot program."""

from collections.abc import Mapping, Sequence

from cell.calibrations import OF_A_TOOL, sort_of, tool_calibration
from cell.store.versions_now import VersionsNow
from daemon.config import CellConfig
from daemon.modbus import register_table
from daemon.tools import tools_of, usual_tool

AXES = ("x_m", "y_m", "z_m", "rx_rad", "ry_rad", "rz_rad")
HIGHEST = 0xFFFF  # of a register


def committed_registers(config: CellConfig, now: VersionsNow) -> dict[str, float]:
    """By register name; poses are m and rad. One state of the ledger, so that all of it belongs together."""
    configured, usual = _configured_poses(config), usual_tool(config)
    found: dict[str, float] = {}
    if usual is not None:
        tool = tool_calibration(usual.name)
        found = {"tool_version": now.versions.get(tool, 0), **_pose("tool", tool, now, configured)}
    if (change := now.change) is None:
        return found
    count = (change.count - 1) % HIGHEST + 1
    return found | {
        "change_count": count,
        "changed_calibration": register_table().register("changed_calibration").number(sort_of(change.name)),
        "changed_version": now.versions.get(change.name, 0),
        "changed_changer": _changer(config, change.name),
        "changed_at_s": change.at,
        **_pose("changed", change.name, now, configured),
        "change_count_again": count,
    }


def _configured_poses(config: CellConfig) -> Mapping[str, Sequence[float] | None]:
    """What is in effect of a pose of which no version is."""
    robot = config.robot
    return {
        "T_flange_camera": robot.T_flange_camera_nominal,
        "T_base_camera": robot.T_base_camera_nominal,
        **{tool_calibration(name): list(tool.T_flange_tool) for name, tool in tools_of(config).items()},
    }


def _changer(config: CellConfig, name: str) -> int:
    """The changer number of the tool whose calibration this is; 0: of no tool that has one."""
    sort, _, owner = name.partition(".")
    tool = tools_of(config).get(owner) if sort in OF_A_TOOL else None
    return (tool.changer or 0) if tool is not None else 0


def _pose(
    prefix: str, name: str, now: VersionsNow, configured: Mapping[str, Sequence[float] | None]
) -> dict[str, float]:
    pose = now.poses.get(name, configured.get(name))
    if not isinstance(pose, list) or len(pose) != len(AXES):
        return {}
    return dict(zip((f"{prefix}_{axis}" for axis in AXES), pose, strict=True))
