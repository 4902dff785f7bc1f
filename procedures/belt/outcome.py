"""What a run of picking came to, as ``cellward.result/1``."""

from collections.abc import Mapping
from typing import Any

from cell.formats.result import Result, Warning_
from procedures.belt.config import BeltTrackingConfig
from procedures.belt.items import Outcome
from procedures.belt.watch import BeltWatch


def result_of(
    watch: BeltWatch, config: BeltTrackingConfig, values: Mapping[str, Any], duration_s: float
) -> dict[str, Any]:
    """Counters, rates and what items were lost to. The verdict warns when items were missed."""
    counts = watch.queue.counts
    picks = counts[Outcome.PICKED]
    misses = {o.value: counts[o] for o in Outcome if o is not Outcome.PICKED and counts[o]}
    tried = picks + counts[Outcome.GRIP_FAILED] + counts[Outcome.LOST]
    warnings = [
        Warning_(code=f"belt.{cause.replace(' ', '-')}", text=f"{n} items: {cause}")
        for cause, n in misses.items()
    ]
    if "belt" in values["configured"] and "belt" not in values["versions"]:
        warnings.append(Warning_(code="belt.nominal", text="m_per_count is the configured one"))
    return Result(
        kind="belt-tracking",
        verdict="warn" if warnings else "pass",
        reasons=[f"{n} missed: {cause}" for cause, n in misses.items()],
        warnings=warnings,
        result={
            "picks": picks,
            "misses": misses,
            "seen": watch.queue.seen,
            "success": picks / tried if tried else None,
            "duration_s": duration_s,
            "picks_per_minute": 60.0 * picks / duration_s if duration_s > 0 else None,
            "counters": watch.queue.live(),
            "follow": config.follow,
            "method": config.method,
        },
        inputs={"belt": values["belt"], "versions": dict(values["versions"])},
    ).as_json()
