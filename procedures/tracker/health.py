"""Health numbers of an arm's geometry, kept over the runs so that wear is seen before scrap."""

from cell.procedure import Run
from procedures.tracker.result import KincalResult
from procedures.trends import keep_trends


async def keep_health(run: Run) -> None:
    """Add what this run measured to the trends."""
    found = run.result
    if not isinstance(found, KincalResult):
        return
    sampling, accuracy = found.inputs.sampling, found.result.absolute_accuracy
    if sampling is None or accuracy is None:
        return
    numbers = {
        f"kinematics.rms_before_m.{sampling.arm}": accuracy.before,
        f"kinematics.rms_after_m.{sampling.arm}": accuracy.after,
    }
    if sampling.monuments is not None:
        numbers[f"tracker.drift_m.{sampling.tracker}"] = sampling.monuments.max_moved_m
    await keep_trends(run, numbers)
