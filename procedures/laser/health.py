"""Health numbers of the beams and the tool, kept over the runs so that drift is seen before scrap."""

from typing import Any

from cell.procedure import Run

AXES = ("x", "y", "z")


async def keep_trends(run: Run) -> None:
    """Add what this run measured to the trends, and their histories to the result's inputs."""
    result = run.result
    if result is None or result["result"] is None:
        return
    histories: dict[str, Any] = {}
    for name, value in _numbers(run, result["result"]).items():
        histories[name] = [[t, v] for t, v in await run.cell.add_trend(name, value)]
    result.setdefault("inputs", {})["trend"] = histories


def _numbers(run: Run, answer: dict[str, Any]) -> dict[str, float]:
    device, tool = run.inputs("beams").name, run.values.tool["name"]
    found: dict[str, Any] = {
        f"beams.latency_s.{device}": answer.get("latency_s"),
        f"beams.hysteresis_m.{device}": answer.get("hysteresis_m"),
    }
    for axis, value in zip(AXES, answer.get("dp_flange") or (), strict=False):
        found[f"tool.offset_{axis}_m.{tool}"] = value
    return {name: float(value) for name, value in found.items() if value is not None}
