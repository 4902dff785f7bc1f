"""What a gripper finds between its fingers: one thing, in a world of its own or by itself, or nothing."""

import numpy as np

from cell.poses import Array
from fakes.world.scenario import Scenario
from fakes.world.world import World
from tests.kit.ideal_world import ideal_text

POINT = np.zeros(3)
NO_ITEM = """
schema = "cellward.scenario/1"
[world.arm]
model = "ur10e"
q_start = [0.0, -1.8, 1.8, -1.57, -1.57, 0.0]
[world.gripper]
output = 0
close_s = 0.3
open_s = 0.3
"""


class Thing:
    """``fakes.world.belt.gripper.Takeable``: one thing at ``POINT``, which fingers take and let go there;
    nothing when ``there`` is False."""

    def __init__(self, there: bool) -> None:
        self.there = there

    def nearest(self, t: float, point: Array) -> tuple[int, Array] | None:
        return (1, POINT) if self.there else None

    def grasp_point(self, number: int, t: float) -> Array:
        return POINT

    def take(self, number: int, t: float) -> None: ...
    def let_go(self, number: int, t: float) -> None: ...


def one_item_under_the_tool() -> str:
    """The picking scenario with a belt that stands and a single item right between the fingers."""
    text = ideal_text("picking")
    x, y, z = World.from_scenario(Scenario.parse(text)).tool_point(0.0)
    lines = {
        "origin": f"[{x}, {y}, {z - 0.03}]",
        "profile": "[{ speed_m_s = 0.0 }]",
        "first_m": "0.0\ncount = 1",
        "jitter_m": "0.0",
        "lateral_m": "0.0",
        "yaw_rad": "0.0",
    }
    keys = [line.split("=")[0].strip() for line in text.splitlines()]
    changed = [
        f"{k} = {lines[k]}" if k in lines else line for k, line in zip(keys, text.splitlines(), strict=True)
    ]
    return "\n".join(changed) + "\n"
