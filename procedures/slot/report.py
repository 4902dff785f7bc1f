"""The report of an insertion: its first page, and what is known of it in words."""

from procedures.report.cover import Cover, CoverFigure, judged
from procedures.report.numbers import mm, mms
from procedures.report.plain import in_words
from procedures.report.source import Source
from procedures.slot.result import SlotResult

_LOOK = "a rack that is moved after the look, a part that slips in the gripper, and parts out of tolerance"


def slot_cover(source: Source[SlotResult]) -> Cover:
    """What became of the part, and the budget beside what is free."""
    found = source.found
    if found is None:
        return Cover()
    answer, budget = found.result, found.result.budget
    where = f"slot {answer.slot} (row {answer.row}, column {answer.column})"
    figures = [CoverFigure(f"{answer.action}, {where}", f"part {answer.part}")]
    if budget is not None:
        figures.append(
            judged("beside the middle, 95 % predicted", budget.predicted_95_m, budget.clearance_m, mm)
        )
    figures.append(
        CoverFigure("rack's model corrected by x, y, z", ", ".join(mms(answer.correction.t)) + " mm")
    )
    if answer.travel_m is not None:
        figures.append(CoverFigure("travel in the slot", mm(answer.travel_m)))
    if answer.force_n is not None:
        figures.append(CoverFigure("force that ended the guarded move", f"{answer.force_n:.1f} N"))
    return Cover(figures, [*found.observability.undetermined, _LOOK])


SLOT = in_words("Part and slot", slot_cover, data_file="slot.json")
