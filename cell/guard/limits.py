"""What the guard holds the arm to: boxes, speeds, and the tool's shape."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from cell.arm_model import Capsule
from cell.errors import error
from cell.joint_limits import per_joint
from cell.poses import Array, from_pose6


@dataclass(frozen=True, eq=False)
class Box:
    """An axis-aligned box in the base frame, ``low`` to ``high`` (3,) m."""

    low: Array
    high: Array
    name: str

    def __post_init__(self) -> None:
        if not np.all(self.low < self.high):
            raise error(
                "CONFIG_INVALID",
                f"box '{self.name}': min {self.low.tolist()} must be below max {self.high.tolist()}",
            )

    @classmethod
    def from_mapping(cls, table: Mapping[str, Any], name: str) -> "Box":
        """From ``{min, max}`` and perhaps ``name``, as in ``[limits]``."""
        return cls(np.array(table["min"], float), np.array(table["max"], float), str(table.get("name", name)))


@dataclass(frozen=True, eq=False)
class GuardLimits:
    """The ``[limits]`` table. The tool stays in the union of ``workspace``, everything out of ``keep_out``.

    Workspace boxes that the arm passes between have to overlap by twice the tool's radius.
    """

    workspace: Sequence[Box]
    keep_out: Sequence[Box]
    speed_m_s: float
    joint_speeds_rad_s: Array  # (6,)

    def __post_init__(self) -> None:
        if not self.workspace:
            raise error(
                "CONFIG_INVALID", "[limits] workspace: need at least one box, or the arm may be nowhere"
            )

    @classmethod
    def from_mapping(cls, table: Mapping[str, Any]) -> "GuardLimits":
        """From the ``[limits]`` table of ``cell.toml``; other keys of that table are not the guard's."""
        return cls(
            workspace=[Box.from_mapping(b, f"workspace {i + 1}") for i, b in enumerate(table["workspace"])],
            keep_out=[
                Box.from_mapping(b, f"keep-out {i + 1}") for i, b in enumerate(table.get("keep_out", ()))
            ],
            speed_m_s=float(table["speed_m_s"]),
            joint_speeds_rad_s=per_joint(table["joint_speed_rad_s"]),
        )


@dataclass(frozen=True)
class Tool:
    """What the flange carries: a capsule from the flange to the TCP, and others in the flange frame.

    The capsule's round end touches the TCP and does not pass it, so a TCP may stand on a workspace face.
    """

    T_flange_tool: RigidTransform
    radius_m: float
    name: str = "tool"
    attachments: tuple[Capsule, ...] = ()

    @classmethod
    def from_mapping(cls, table: Mapping[str, Any]) -> "Tool":
        """From ``[robot] tool``: ``T_flange_tool`` as a pose6, ``radius_m``, ``name``."""
        return cls(
            from_pose6(table["T_flange_tool"]), float(table["radius_m"]), str(table.get("name", "tool"))
        )

    def capsules(self) -> list[Capsule]:
        """Everything on the flange, in the flange frame."""
        tip = self.T_flange_tool.translation
        length = float(np.linalg.norm(tip))
        end = tip * max(0.0, 1.0 - self.radius_m / length) if length > 0.0 else tip
        return [Capsule(np.zeros(3), end, self.radius_m, self.name), *self.attachments]
