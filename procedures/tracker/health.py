"""Health numbers of an arm's geometry, kept over the runs so that wear is seen before scrap."""

from typing import Any

from cell.procedure import Run


async def keep_trends(run: Run) -> None:
    """Add what this run measured to the trends, and their histories to the result's inputs."""
    result = run.result
    if result is None or result["result"] is None:
        return
    sampling = result["inputs"]["sampling"]
    accuracy = result["result"]["absolute_accuracy"]
    arm, tracker = sampling["arm"], sampling["tracker"]
    numbers = {
        f"kinematics.rms_before_m.{arm}": accuracy["before"],
        f"kinematics.rms_after_m.{arm}": accuracy["after"],
    }
    if sampling["monuments"] is not None:
        numbers[f"tracker.drift_m.{tracker}"] = sampling["monuments"]["max_moved_m"]
    histories: dict[str, Any] = {}
    for name, value in numbers.items():
        if value is not None:
            histories[name] = [[t, v] for t, v in await run.cell.add_trend(name, float(value))]
    result["inputs"]["trend"] = histories
