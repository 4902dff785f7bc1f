"""Health numbers of the beams and the tool, kept over the runs so that drift is seen before scrap."""

from cell.procedure import Run
from procedures.laser.result import LaserResult, ReferenceResult
from procedures.trends import keep_trends

AXES = ("x", "y", "z")


async def keep_health(run: Run) -> None:
    """Add what this run measured to the trends."""
    found = run.result
    if not isinstance(found, LaserResult | ReferenceResult):
        return
    numbers = {f"beams.hysteresis_m.{run.inputs('beams').name}": found.result.hysteresis_m}
    if isinstance(found, LaserResult):
        numbers[f"beams.latency_s.{run.inputs('beams').name}"] = found.result.latency_s
        tool = run.values.tool["name"]
        for axis, value in zip(AXES, found.result.dp_flange, strict=True):
            numbers[f"tool.offset_{axis}_m.{tool}"] = value
    await keep_trends(run, numbers)
