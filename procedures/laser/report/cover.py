"""The first page of a crossed-beam report."""

import numpy as np

from procedures.laser.report.limits import limit_rows
from procedures.laser.report.source import LaserSource
from procedures.report.cover import Cover, CoverFigure, judged
from procedures.report.numbers import deg, mm, mms

_IF = (
    "an arm that does not repeat, beams that were moved since the reference, and polls whose clock is not "
    "the arm's: the uncertainty holds if none of them is so"
)
_LENGTH = "an error of the configured tool: it moves beams and hits together, and checks are free of it"


def laser_cover(source: LaserSource) -> Cover:
    """How far the tool is off, or where the beams are, beside every limit of the job."""
    if source.found is None:
        return Cover()
    figures = []
    if source.dp is not None:
        size = float(np.linalg.norm(source.dp))
        figures.append(CoverFigure("point off the reference", mm(size), f"± {mm(source.U)}"))
        figures.append(CoverFigure("the same along flange x, y, z", ", ".join(mms(source.dp)) + " mm"))
        if source.drot is not None:
            figures.append(CoverFigure("axis off the reference", deg(float(np.linalg.norm(source.drot)))))
    figures += [judged(*row) for row in limit_rows(source)]
    open_ = list(source.found.observability.undetermined)
    return Cover(figures, [*open_, _LENGTH if source.is_reference else _IF])
