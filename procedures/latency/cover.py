"""The first page of the report of a delay."""

from procedures.latency.result import LatencyResult
from procedures.report.cover import Cover, CoverFigure, judged
from procedures.report.numbers import DASH, dig, mm, number
from procedures.report.source import Source

_CONSTANT = "a delay that changes: it was measured as a constant, at the load that the network had"


def latency_cover(source: Source[LatencyResult]) -> Cover:
    """How late the source is, beside the limits of the job."""
    found = source.found
    if found is None:
        return Cover()
    answer, limits = found.result, dig(source.run, "job_config", "accept")
    low, high = answer.interval95_s
    figures = [
        judged(
            f"stamps of '{answer.source}' are late by",
            answer.time_offset_s,
            dig(limits, "max_offset_s"),
            _ms,
            uncertainty=f"{_ms(low)} … {_ms(high)}",
        ),
        judged("width of the 95 % interval", high - low, dig(limits, "max_interval_s"), _ms),
        CoverFigure("its driver takes off already", _ms(answer.applied_s)),
        CoverFigure("readings held out, RMS", mm(found.heldout.rms_m)),
    ]
    return Cover(figures, [*found.observability.undetermined, _CONSTANT])


def _ms(seconds: object) -> str:
    value = number(seconds)
    return DASH if value is None else f"{1e3 * value:.2f} ms"
