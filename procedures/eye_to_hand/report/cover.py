"""The first page of the report of an eye-to-hand check."""

from procedures.eye_to_hand.result import AxbcResult
from procedures.eye_to_hand.words import BLAMED, WAYS
from procedures.report.cover import Cover, CoverFigure, judged
from procedures.report.numbers import K95, deg, dig, mm
from procedures.report.source import Source

_COMMON = "an error that camera, target and arm share, a wrong size of the target for instance"
_PLACES = "parts of the workspace where the target was not seen"


def axbc_cover(source: Source[AxbcResult]) -> Cover:
    """How far the given hand-eye is off, beside the limits, and what is blamed."""
    found = source.found
    if found is None:
        return Cover()
    answer, limits = found.result, dig(source.run, "job_config", "accept")
    sigma = answer.eval_sigma
    figures = [
        judged(
            "the given hand-eye is off by",
            answer.eval.t,
            dig(limits, "max_error_t_m"),
            mm,
            uncertainty=f"± {mm(K95 * sigma.t)}",
        ),
        judged(
            "and is turned by",
            answer.eval.r,
            dig(limits, "max_error_r_rad"),
            deg,
            uncertainty=f"± {deg(K95 * sigma.r)}",
        ),
        CoverFigure("target off its given place by", f"{mm(answer.C_offset.t)}, {deg(answer.C_offset.r)}"),
        CoverFigure("blamed", BLAMED[answer.blamed]),
        CoverFigure("positioning through the camera, RMS", mm(answer.positioning.t_rms)),
        CoverFigure(
            f"held-out, corrected by {WAYS[answer.correction.chosen]}",
            mm(answer.correction.by_way()[answer.correction.chosen]),
        ),
        CoverFigure("observations used", f"{found.inputs.used} of {found.inputs.observations}"),
    ]
    return Cover(figures, [_COMMON, _PLACES])
