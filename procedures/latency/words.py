"""The delay of a source in words."""

from procedures.laser.words import hysteresis_lines
from procedures.latency.result import LatencyResult
from procedures.words import ms


def latency_lines(found: LatencyResult) -> list[str]:
    """How late a source is, and what its driver takes off already."""
    answer, (low, high) = found.result, found.result.interval95_s
    return [
        f"  the stamps of '{answer.source}' are late by {ms(answer.time_offset_s)}, "
        f"95 % interval {ms(low)} to {ms(high)}",
        f"  its driver takes off {ms(answer.applied_s)}",
        *hysteresis_lines(answer.hysteresis_m),
    ]
