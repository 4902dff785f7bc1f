"""Health numbers over the runs: what creeps shows there before parts are bad."""

from collections.abc import Mapping

from cell.procedure import Run


async def keep_trends(run: Run, numbers: Mapping[str, float | None]) -> None:
    """Add the ``numbers`` that are known to the trends, and their histories to the inputs of the result."""
    histories = {
        name: [[t, v] for t, v in await run.cell.add_trend(name, float(value))]
        for name, value in numbers.items()
        if value is not None
    }
    if run.result is not None:
        run.result = run.result.with_inputs(trend=histories)
