"""The report of a touch test: its first page, and the result in words."""

from procedures.report.cover import Cover, CoverFigure
from procedures.report.numbers import deg, mm
from procedures.report.plain import in_words
from procedures.report.source import Source
from procedures.touch_test.data import DATA_FILE
from procedures.touch_test.result import TouchResult


def touch_cover(source: Source[TouchResult]) -> Cover:
    """What the tool's point is off by at the board, with its uncertainty."""
    found = source.found
    if found is None:
        return Cover()
    answer, of = found.result, found.uncertainty
    figures = [
        CoverFigure(
            "tool's point off at the board", mm(answer.shift_m), uncertainty=f"± {mm(of.shift_95_m)}"
        ),
        CoverFigure("turned against the board", deg(answer.turn_rad), uncertainty=f"± {deg(of.turn_95_rad)}"),
        CoverFigure("corners", str(len(answer.corners))),
    ]
    return Cover(figures, found.observability.undetermined)


TOUCH = in_words("Touch test", touch_cover, data_file=DATA_FILE)
