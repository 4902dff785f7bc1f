"""The first page of the report of a test of accuracy and repeatability."""

from procedures.iso9283.report.source import IsoSource
from procedures.report.cover import Cover, CoverFigure, judged
from procedures.report.numbers import DASH, dig, mm, mms

_CONDITIONS = "another load, speed, temperature or part of the workspace than the five poses of this test"


def iso9283_cover(source: IsoSource) -> Cover:
    """The worst AP and RP beside the limits, and the cycles that were asked for."""
    found = source.found
    if found is None:
        return Cover()
    answer, limits = found.result, dig(source.run, "job_config")
    spread = {p.name: p.RP_95 for p in source.poses}.get(max(answer.RP, key=answer.RP.__getitem__))
    figures = [
        judged(
            "pose accuracy AP, worst pose",
            answer.AP_max,
            dig(limits, "max_AP_m"),
            mm,
            uncertainty=f"± {mm(found.uncertainty.AP_U[max(answer.AP, key=answer.AP.__getitem__)])}",
        ),
        judged(
            "pose repeatability RP, worst pose",
            answer.RP_max,
            dig(limits, "max_RP_m"),
            mm,
            uncertainty=DASH if spread is None else f"{' … '.join(mms(spread))} mm",
        ),
        CoverFigure(
            "tracker alone, of a perfect arm",
            f"AP {mm(answer.tracker.AP_95_m)}, RP {mm(answer.tracker.RP_m)}",
        ),
        CoverFigure("cycles", str(answer.cycles), planned=str(answer.cycles_wanted)),
        CoverFigure(
            "commanded", "through the calibrated kinematics" if answer.corrected else "by the controller"
        ),
        CoverFigure("speed, payload", f"{100 * answer.speed_share:g} %, {answer.payload_kg:g} kg"),
    ]
    return Cover(figures, [*found.observability.undetermined, _CONDITIONS])
