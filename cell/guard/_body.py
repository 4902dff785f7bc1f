"""The arm with its tool as capsules, for many joint vectors at a time."""

import numpy as np

from cell.arm_model import ArmModel
from cell.guard.limits import Tool
from cell.poses import Array

Names = tuple[str, ...]


class Body:
    """Links first, then everything on the flange."""

    def __init__(self, model: ArmModel, tool: Tool) -> None:
        on_flange = tool.capsules()
        self._model = model
        self._tool_ends = np.array([[c.p0, c.p1] for c in on_flange])
        self.links = len(model.links)
        self.names: Names = (*(s.name for s in model.links), *(c.name for c in on_flange))
        self.radii = np.array([*(s.radius_m for s in model.links), *(c.radius_m for c in on_flange)])
        self.joints_before = np.array([*(s.joints_before for s in model.links), *(6 for _ in on_flange)])
        extent = max(float(np.max(np.linalg.norm([c.p0, c.p1], axis=1))) + c.radius_m for c in on_flange)
        self.tool_reach = extent
        #: (6,) m: no point of the body is farther from joint i's axis, if that joint moves it.
        self.reach_after = model.reach_after + max(extent, float(np.max(self.radii)))
        self.self_pairs = _self_pairs(self.joints_before)

    def flange(self, Q: Array) -> Array:
        """(n, 4, 4): ``T_base_flange`` for joints ``Q`` (n, 6)."""
        return self._model.flange_many(Q)

    def ends(self, Q: Array, flange: Array | None = None) -> Array:
        """(n, m, 2, 3): both ends of each capsule in the base; ``flange`` (n, 4, 4) if it is known."""
        flange = self.flange(Q) if flange is None else flange
        tool = np.einsum("nij,kej->nkei", flange[:, :3, :3], self._tool_ends) + flange[:, None, None, :3, 3]
        return np.concatenate([self._model.link_ends(Q), tool], axis=1)


def _self_pairs(joints_before: Array) -> Array:
    """(p, 2) capsules that can meet: three or more joints apart, as neighbours' housings overlap."""
    pairs = [
        (i, j)
        for j in range(len(joints_before))
        for i in range(j)
        if joints_before[j] - joints_before[i] >= 3 and joints_before[j] >= 5
    ]
    return np.array(pairs, dtype=int).reshape(-1, 2)
