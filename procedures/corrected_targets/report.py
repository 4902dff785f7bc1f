"""The report of targets that were handed to an observed arm: its first page, and the result in words."""

from procedures.corrected_targets.record import DATA_FILE
from procedures.corrected_targets.result import TargetsResult
from procedures.report.cover import Cover, CoverFigure, judged
from procedures.report.numbers import DASH, dig, mm
from procedures.report.plain import in_words
from procedures.report.source import Source

_CONDITIONS = "other targets, another load, and an arm that has warmed up or worn since"


def targets_cover(source: Source[TargetsResult]) -> Cover:
    """The worst target before and after, beside the limit."""
    found = source.found
    if found is None:
        return Cover()
    answer, bound = found.result, found.uncertainty.error_95_m
    figures = [
        judged(
            "off at the worst target, corrected",
            answer.after.max_m,
            dig(source.run, "job_config", "max_error_m"),
            mm,
            uncertainty=DASH if bound is None else f"± {mm(bound)}",
        ),
        CoverFigure("targets", str(answer.after.targets), planned=str(len(answer.targets))),
        CoverFigure("seen by", answer.seen_by),
    ]
    if answer.before is not None:
        figures.insert(1, CoverFigure("off at the worst target, as given", mm(answer.before.max_m)))
    return Cover(figures, [*found.observability.undetermined, _CONDITIONS])


TARGETS = in_words("Corrected targets", targets_cover, data_file=DATA_FILE)
