"""A world in which the tool stands over a single item, which lies still between its fingers."""

from fakes.world.scenario import Scenario
from fakes.world.world import World
from tests.kit.ideal_world import ideal_text


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
