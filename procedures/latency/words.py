"""The delay of a source in words."""

from collections.abc import Mapping
from typing import Any

from procedures.laser.words import hysteresis_lines
from procedures.words import ms


def latency_lines(result: Mapping[str, Any], answer: Mapping[str, Any]) -> list[str]:
    """How late a source is, and what its driver takes off already."""
    low, high = answer["interval95_s"]
    return [
        f"  the stamps of '{answer.get('source')}' are late by {ms(answer['time_offset_s'])}, "
        f"95 % interval {ms(low)} to {ms(high)}",
        f"  its driver takes off {ms(answer.get('applied_s'))}",
        *hysteresis_lines(answer),
    ]
