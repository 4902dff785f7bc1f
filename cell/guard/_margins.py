"""How close a pose comes to its limits, for the listing of a plan."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from cell.arm_model import ArmModel
from cell.guard._rules import Rules
from cell.poses import Array


@dataclass(frozen=True)
class PoseMargins:
    """Distances to the limits of one pose; negative where a limit is broken."""

    joint_rad: float
    joint: str  # the joint closest to its range's end
    clearance_m: float | None  # to the nearest keep-out box; None without boxes
    clearance: str  # the link or tool, and the box
    workspace_m: float  # depth of wrist and tool in the workspace
    floor_m: float
    self_m: float
    singularity: float  # smallest singular value of the Jacobian, lengths in metres; 0 at a singular pose

    @property
    def ok(self) -> bool:
        """Whether every limit is kept."""
        clearance = 0.0 if self.clearance_m is None else self.clearance_m
        return min(self.joint_rad, clearance, self.workspace_m, self.floor_m, self.self_m) >= 0.0

    def as_dict(self) -> dict[str, Any]:
        """For journals, results and ``--json``."""
        return asdict(self)


def margins_of(q: Array, model: ArmModel, rules: Rules, ends: Array, joints: tuple[str, ...]) -> PoseMargins:
    """The margins of ``q`` (6,) rad with the capsules ``ends`` (1, m, 2, 3)."""
    low, high = model.joint_limits.T
    room = np.minimum(q - low, high - q)
    boxes = (box.smallest() for box in rules.keep_out(ends, within=np.inf))
    nearest = min(boxes, key=lambda f: f.slack_m, default=None)
    return PoseMargins(
        joint_rad=float(np.min(room)),
        joint=joints[int(np.argmin(room))],
        clearance_m=None if nearest is None else nearest.slack_m,
        clearance="" if nearest is None else nearest.text,
        workspace_m=rules.workspace(ends).smallest().slack_m,
        floor_m=rules.floor(ends).smallest().slack_m,
        self_m=rules.self_contact(ends).smallest().slack_m,
        singularity=float(np.linalg.svd(model.jacobian(q), compute_uv=False)[-1]),
    )
